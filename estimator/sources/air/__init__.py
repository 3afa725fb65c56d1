"""Motion through the air and the wind: airspeed, drag of a multirotor.

Begin with `wind`. May import estimator.sources.base, estimator.sources.rest, models.
"""
