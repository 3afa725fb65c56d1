"""From a stereo pair to a LandmarkFix: one stage, one file, functions on arrays.

May import models, numpy, scipy, numba and OpenCV; no I/O, no clock, no threads.
"""
