"""The Zenoh links: ROS 2 keys, PX4's keys, configuration. Begin with `bus`.

May import estimator.service.autopilot and estimator.service.base, estimator.publish, logs and models.
"""
