"""Which landmark a region is: likelihoods with everything that is uncertain, assignment, ambiguity, clutter.

Begin with `identify`. May import describe and image.
"""
