"""Which landmark a region is: likelihoods, assignment, ambiguity, clutter.

Begin with `identify`. May import describe and image.
"""
