"""A log through the estimator, and logs made by the simulator: the same `Fusion.handle` as in flight, and the same bits.

Begin with `replay` and `simulate`. May import estimator.frontend and what is below it, logs, calib, vision and models.
"""
