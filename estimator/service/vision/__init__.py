"""The visual front-end in a process of its own. Begin with `worker`.

May import estimator.service.base, estimator.frontend and the layers below it.
"""
