"""Shared by the daemon's parts.

May import estimator.strict_toml, logs, models.
"""
