"""Maps on disk. Begin with `store`.

May import estimator.strict_toml, vision and models.
"""
