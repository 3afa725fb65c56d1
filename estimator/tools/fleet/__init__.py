"""Many flights, a row each.

Begin with `run`, `compare`. May import estimator.replay and the layers below it, logs, models.
"""
