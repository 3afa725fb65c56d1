"""Checks before a flight: the machine, the configuration and its files, a log. Each is a list of Check with advice.

Begin with `machine`. May import estimator.config and what is below it.
"""
