"""Calibration of cameras, stereo rig and camera-IMU pose from recordings, with reports.

May import vision and models, numpy, scipy and OpenCV; no filter.
"""
