"""Regions of an image in metres.

    segment -> regions -> correspond -> measure;  survey: all of it

Begin with `survey`. May import image.
"""
