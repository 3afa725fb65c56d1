"""The IMU: Allan deviation, scale, misalignment, camera pose. Begin with `imu` and `camera_imu`.

May import calib.report and the layers below it.
"""
