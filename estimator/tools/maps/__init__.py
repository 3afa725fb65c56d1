"""Maps checked, drawn, learned from a flight, extracted from an image. Begin with `check`.

May import estimator.tools.doctor (Check), estimator.config and the layers below it.
"""
