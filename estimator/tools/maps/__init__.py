"""Maps checked, drawn, learned, extracted. Begin with `check`.

May import estimator.tools.doctor (Check), estimator.config and the layers below it.
"""
