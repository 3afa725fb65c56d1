"""Regions of an image in metres.

    segment -> regions -> correspond (left and right) -> measure;  survey: all of it for a pair

Begin with `survey`. May import image.
"""
