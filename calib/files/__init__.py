"""Rigs on disk: our YAML, and OpenCV's, Kalibr's and ROS' formats, read and written.

Begin with `formats` (any of them) and `rig_yaml`. May import calib.errors and models.
"""
