"""The outline of a landmark in an image: visible edges, profiles, sub-pixel steps, lines and their noise.

May import describe and image.
"""
