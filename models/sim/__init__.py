"""Simulation: true motion, sensors with their errors, faults, scenarios in TOML, and the bound no filter can beat.

May import models.
"""
