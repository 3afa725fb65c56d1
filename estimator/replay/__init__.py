"""Replay to the bits of the flight; simulated logs. Begin with `replay`.

May import estimator.frontend and the layers below it, logs, calib, vision, models.
"""
