"""Shared by the daemon's parts: ports, clock, status, secrets.

May import estimator.strict_toml, logs and models; nothing else of the service.
"""
