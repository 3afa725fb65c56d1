"""Simulation: motion, sensor errors, faults, TOML scenarios, Cramer-Rao bound.

May import models.
"""
