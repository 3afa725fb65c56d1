"""Boards seen by cameras whose truth is known, and moving ones. May import everything of calib."""
