"""A map from a flight.

Begin with `mapping`. May import identify and what is below it.
"""
