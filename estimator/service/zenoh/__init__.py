"""The Zenoh links. Begin with `bus`.

May import estimator.service.autopilot and estimator.service.base, estimator.publish, logs and models.
"""
