"""The physics.

Pure functions on arrays; conventions: docs/conventions.md. May import numpy, scipy, numba, pymap3d, msgspec.
"""
