"""The IMU: Allan deviation at rest, scale and misalignment, and its pose on the camera. Begin with `imu` and `camera_imu`.

May import calib.report and the layers below it.
"""
