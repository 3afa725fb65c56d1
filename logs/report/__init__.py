"""The report: map, plots, rejections with reasons in one HTML file; scripts and style are `*.js` and `page.css` here.

Begin with `write`. May import logs.evaluation and the layers below it.
"""
