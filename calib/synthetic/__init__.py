"""Boards seen by known cameras. May import everything of calib."""
