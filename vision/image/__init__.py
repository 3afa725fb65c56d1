"""The camera's image before anything is recognised in it: is it one, lens taken out, contrast, reduced copies.

Begin with `rectify`. May import models, nothing else of vision.
"""
