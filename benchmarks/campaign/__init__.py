"""Consistency over many simulated flights."""
