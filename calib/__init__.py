"""Calibration of cameras, stereo rig, camera-IMU pose from recordings.

May import vision, models, numpy, scipy, OpenCV.
"""
