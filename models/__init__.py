"""The physics: messages, rotations, frames, the state table, motion and measurement models, simulation.

Pure functions on arrays, without I/O, clock or threads; conventions: docs/conventions.md. May import numpy, scipy, numba, pymap3d
and msgspec.
"""
