"""Predict and verify: outlines drawn at the prior, searched, fitted, checked.

    motion, edge_points -> votes -> global_search, coarse_search -> fit -> final_check, presence -> verify

Begin with `predict`. May import records, pose and the layers below it.
"""
