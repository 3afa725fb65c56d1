"""The map drawn into recorded images: video, contact sheet, residuals along a log, the images of a report.

Begin with `log` and `video`. May import estimator.config and what is below it.
"""
