"""Integrity: a bound on the position error at a stated risk, and an alert; reads the filter only.

Begin with protection.py. May import estimator.filter, estimator.sources and models.
"""
