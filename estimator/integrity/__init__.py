"""A bound on the position error, and an alert.

Begin with protection.py. May import estimator.filter, estimator.sources, models.
"""
