"""Output to an autopilot.

May import estimator.service.base, logs, models.
"""
