"""Maps and their images on disk: GeoJSON, orthophotos, rasters of heights. Begin with `store` and `image`.

May import estimator.strict_toml, vision and models.
"""
