"""From a stereo pair to a LandmarkFix: pure functions, one file a stage.

May import models, numpy, scipy, numba, OpenCV.
"""
