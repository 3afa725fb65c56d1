"""Faults of the optional sensors: what each costs, and what is reported."""
