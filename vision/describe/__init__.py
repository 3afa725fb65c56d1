"""Regions of an image in metres: outline, width, length, size, fill ratio, colour.

    segment -> regions -> correspond (left and right) -> measure;  survey: all of it for a pair

Begin with `survey`. May import image.
"""
