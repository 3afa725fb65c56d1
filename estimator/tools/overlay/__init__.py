"""The map drawn into recorded images. Begin with `log`, `video`.

May import estimator.config and the layers below it.
"""
