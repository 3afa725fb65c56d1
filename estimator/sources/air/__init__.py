"""Motion through the air, and the wind.

Begin with `wind`. May import estimator.sources.base, estimator.sources.rest, models.
"""
