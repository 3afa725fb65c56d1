"""Landmarks on a map: outlines, heights, colours, look-up, GeoJSON. Begin with `landmarks`.

May import the modules of models, not models.sim.
"""
