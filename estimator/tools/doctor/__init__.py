"""Checks before a flight: machine, configuration and files, a log; each a list of Check with advice. Begin with `machine`.

May import estimator.config and the layers below it.
"""
