"""How good an estimate was: errors, consistency, drift in outages, what became of each measurement; of one log or several.

Begin with `evaluate`. May import logs.store, logs.wire and models.
"""
