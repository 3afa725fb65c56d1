"""The MAVLink link: ports and signing, messages in and out, its configuration. Begin with `link`.

May import estimator.service.autopilot and estimator.service.base, estimator.publish, logs and models.
"""
