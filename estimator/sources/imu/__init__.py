"""The IMU: whether its samples can be used (`plausibility`), and which of several IMUs leads (`choice`).

Begin with `choice`. May import estimator.sources.base and models.
"""
