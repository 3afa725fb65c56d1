"""Landmarks on a map: outlines, heights and colours, how they are looked up, and the map as GeoJSON.

Pure functions: text and arrays go in and come out, `estimator.map_files` reads and writes the files. Begin with `landmarks`.
May import the modules of models, not models.sim.
"""
