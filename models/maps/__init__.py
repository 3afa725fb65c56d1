"""Landmarks on a map: outlines, heights and colours, look-up, and the map as GeoJSON text. Begin with `landmarks`.

May import the modules of models, not models.sim.
"""
