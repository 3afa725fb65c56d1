"""Images before recognition: check, rectification, contrast, reduction. Begin with `rectify`.

May import models, nothing else of vision.
"""
