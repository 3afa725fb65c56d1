"""What shows the motion through the air, and the wind that comes with it: airspeed, and the drag of a multirotor.

Begin with `wind`. May import estimator.sources.base, rest's test of quiet samples, and models.
"""
