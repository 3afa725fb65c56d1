"""Shared by the daemon's parts: ports, clock, status, secrets. Begin with `ports`.

May import estimator.strict_toml, logs and models; nothing else of the service.
"""
