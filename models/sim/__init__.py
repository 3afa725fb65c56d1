"""Simulation, Cramer-Rao bound.

May import models.
"""
