"""Quality of an estimate.

Begin with `evaluate`. May import logs.store, logs.wire, models.
"""
