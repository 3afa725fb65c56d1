"""The report: one HTML file.

Begin with `write`. May import logs.evaluation and what is below it.
"""
