"""The Zenoh links: topics as ROS 2 keys, PX4's own keys, their configuration. Begin with `bus`.

May import estimator.service.autopilot and estimator.service.base, estimator.publish, logs and models.
"""
