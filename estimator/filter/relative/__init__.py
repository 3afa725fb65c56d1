"""Measurements of motion against a pose that each filter keeps. May import estimator.filter.hypotheses and what is below it."""
