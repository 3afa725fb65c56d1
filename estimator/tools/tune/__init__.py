"""Noise parameters from logs without truth: keys, score, search. Begin with `search`.

May import estimator.config and the layers below it.
"""
