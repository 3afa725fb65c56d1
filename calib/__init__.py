"""Cameras, stereo rig and camera-IMU pose, estimated from recordings, each with a report.

May import vision and models, numpy, scipy and OpenCV; no filter.
"""
