"""The daemon's files: the log, repair of torn logs, the state to resume from. Begin with `writer`.

May import estimator.service.base, logs and models.
"""
