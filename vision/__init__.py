"""From a stereo pair to a LandmarkFix: one stage, one file, functions on arrays, without I/O, clock or threads.

May import models, numpy, scipy, numba and OpenCV.
"""
