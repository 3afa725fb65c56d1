"""A map from a flight: regions seen repeatedly become landmarks.

Begin with `mapping`. May import identify and what is below it.
"""
