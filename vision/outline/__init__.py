"""The outline of a landmark in an image: which edges are visible, profiles across them, sub-pixel steps, lines and their noise.

May import describe and image.
"""
