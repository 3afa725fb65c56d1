"""The camera's image before recognition: check, rectification, contrast, reduced copies. Begin with `rectify`.

May import models, nothing else of vision.
"""
