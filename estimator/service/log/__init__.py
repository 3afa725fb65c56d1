"""The daemon's files. Begin with `writer`.

May import estimator.service.base, logs and models.
"""
