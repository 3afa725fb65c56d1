"""The IMU. Begin with `imu`, `camera_imu`.

May import calib.report and the layers below it.
"""
