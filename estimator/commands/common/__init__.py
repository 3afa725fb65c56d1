"""Shared by commands.

May import calib, logs, vision.
"""
