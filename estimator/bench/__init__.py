"""Benchmarks that a user runs himself: what the vehicle's eyes recognise, with what others would.

May import estimator.frontend and what is below it, logs, vision and models.
"""
