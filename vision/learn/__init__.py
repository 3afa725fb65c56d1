"""A map from a flight: regions seen again and again become landmarks.

Begin with `mapping`. May import identify and what is below it.
"""
