"""The MAVLink link: ports and signing, messages in and out, the configuration of it.

Begin with `link`. May import estimator.service.autopilot and estimator.service.base, estimator.publish, logs and models.
"""
