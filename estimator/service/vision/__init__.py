"""The visual front-end in a process of its own: whatever happens to it, the estimate goes on.

Begin with `worker`. May import estimator.service.base, estimator.frontend and what is below it.
"""
