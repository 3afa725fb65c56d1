"""Maps on disk: GeoJSON, orthophotos, height rasters. Begin with `store` and `image`.

May import estimator.strict_toml, vision and models.
"""
