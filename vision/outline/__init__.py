"""A landmark's outline in an image: visible edges, profiles, steps, lines, noise.

May import describe and image.
"""
