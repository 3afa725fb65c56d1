"""The page to look at: map, plots, refusals with reasons; one file of HTML, its scripts and style are `*.js` and `page.css` here.

Begin with `write`. May import logs.evaluation and what is below it.
"""
