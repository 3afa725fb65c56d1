"""Maps and their images on disk: GeoJSON of landmarks, orthophotos, rasters of heights.

Begin with `store` (landmarks) and `image` (the map's image). May import estimator.strict_toml, vision and models.
"""
