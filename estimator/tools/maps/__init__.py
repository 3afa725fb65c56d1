"""Maps checked, drawn, learned from a flight and found in a satellite image. Begin with `check`.

May import estimator.tools.doctor (Check), estimator.config and the layers below it.
"""
