"""Logs through the same `Fusion.handle` as in flight, to the same bits; simulated logs. Begin with `replay` and `simulate`.

May import estimator.frontend and the layers below it, logs, calib, vision and models.
"""
