"""Motion through the air and the wind: airspeed, drag of a multirotor.

Begin with `wind`. May import estimator.sources.base, rest's test of quiet samples, and models.
"""
