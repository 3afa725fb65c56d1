"""A bound on the position error at a stated risk, and an alert.

Begin with protection.py. May import estimator.filter, estimator.sources, models.
"""
