"""Position by a georeferenced image: registration and features.

Begin with `registration`. May import pose and what is below it.
"""
