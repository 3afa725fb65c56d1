"""Landmarks on a map. Begin with `landmarks`.

May import the modules of models, not models.sim.
"""
