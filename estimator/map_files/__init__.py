"""Maps and their pictures on disk: GeoJSON of landmarks, orthophotos, rasters of heights.

Begin with `store` (landmarks) and `picture` (the map's picture). May import estimator.strict_toml, vision and models.
"""
