"""The MAVLink link: ports, signing, messages in and out. Begin with `link`.

May import estimator.service.autopilot and estimator.service.base, estimator.publish, logs and models.
"""
