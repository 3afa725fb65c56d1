"""Shared by commands: output, sources of images, views of a board.

May import calib, logs and vision; no command.
"""
