"""Simulation.

May import models.
"""
