"""Vision in its own process. Begin with `worker`.

May import estimator.service.base, estimator.frontend and the layers below it.
"""
