"""Cameras, the stereo rig and its place on the vehicle, estimated from recordings, each with a report.

May import vision and models, numpy, scipy and OpenCV. The camera-IMU calibration minimises a function it is given, so no filter.
"""
