"""What the daemon leaves on disk: the log, torn logs of an earlier crash made whole, the state to resume from.

Begin with `writer`. May import estimator.service.base, logs and models.
"""
