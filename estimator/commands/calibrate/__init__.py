"""`landfix calibrate`: mono, stereo, camera-imu, imu. May import estimator.commands.common, estimator.config and calib."""
