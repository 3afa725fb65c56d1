"""The map's image: position by registration with an orthophoto and by features.

Begin with `registration`. May import pose and what is below it.
"""
