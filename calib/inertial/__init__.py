"""The IMU: noise and walk at rest (Allan deviation), scale and misalignment, and its place on the camera.

Begin with `imu` and `camera_imu`. May import calib.report and what is below it.
"""
