"""Output to an autopilot: clock, output policy, units and frames of messages.

May import estimator.service.base, logs and models.
"""
