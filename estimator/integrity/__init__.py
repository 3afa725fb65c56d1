"""Integrity: a bound on the position error at a stated risk, and an alert. Reads the filter only.

Begin with protection.py, then faults.py, monitor.py, alert.py. May import estimator.filter, estimator.sources and models.
"""
