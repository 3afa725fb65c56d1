"""Noise parameters from logs without a truth: what to vary, what a log is worth, the search.

Begin with `search`. May import estimator.config and what is below it.
"""
