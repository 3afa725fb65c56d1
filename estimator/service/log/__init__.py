"""The daemon's files: log, repair of torn logs, state to resume from. Begin with `writer`.

May import estimator.service.base, logs and models.
"""
