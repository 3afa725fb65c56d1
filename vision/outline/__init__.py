"""A landmark's outline in an image.

May import describe and image.
"""
