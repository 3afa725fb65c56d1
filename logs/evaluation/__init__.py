"""Quality of an estimate: errors, consistency, drift in outages, decisions; of one log or several.

Begin with `evaluate`. May import logs.store, logs.wire and models.
"""
