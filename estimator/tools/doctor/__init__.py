"""Checks before a flight, with advice. Begin with `machine`.

May import estimator.config and the layers below it.
"""
