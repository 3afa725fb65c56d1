"""The IMU: usable samples (`plausibility`), the leading one of several (`choice`).

May import estimator.sources.base and models.
"""
