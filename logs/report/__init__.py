"""The report: map, plots, rejections in one HTML file; scripts and style beside.

Begin with `write`. May import logs.evaluation and the layers below it.
"""
