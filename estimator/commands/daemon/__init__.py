"""Commands about the daemon: run, monitor, start.

May import estimator.commands.common, config and service.
"""
