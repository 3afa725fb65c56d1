"""Rigs on disk: our YAML, and OpenCV's, Kalibr's and ROS' formats. Begin with `formats` and `rig_yaml`.

May import calib.errors and models.
"""
