"""Integrity: a bound on the position error with a stated risk, and an alert when it is too large for the flight.

Begin with protection.py (the equation), then faults.py (what may be wrong), monitor.py (when it is computed) and alert.py.
Reads the filter and changes nothing of it. May import estimator.filter, estimator.sources and models.
"""
