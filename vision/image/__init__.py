"""Images before recognition. Begin with `rectify`.

May import models.
"""
