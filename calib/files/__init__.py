"""Rigs on disk. Begin with `formats`.

May import calib.errors and models.
"""
