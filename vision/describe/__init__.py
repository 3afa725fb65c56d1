"""Regions of an image and their description: outline, width, length, size, fill ratio and colour, in metres from two cameras.

    segment -> regions -> correspond (left and right) -> measure;  survey: all of it for a pair

Begin with `survey`. May import image.
"""
