"""Reports and images.

May import pose and what is below it.
"""
