"""Which landmark a region is.

Begin with `identify`. May import describe and image.
"""
