"""Position by a georeferenced image.

Begin with `registration`. May import pose and what is below it.
"""
