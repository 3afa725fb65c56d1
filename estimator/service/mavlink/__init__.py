"""The MAVLink link. Begin with `link`.

May import estimator.service.autopilot and estimator.service.base, estimator.publish, logs and models.
"""
