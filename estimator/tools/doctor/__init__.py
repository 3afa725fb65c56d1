"""Checks before a flight (machine, configuration, files, a log), with advice. Begin with `machine`.

May import estimator.config and the layers below it.
"""
