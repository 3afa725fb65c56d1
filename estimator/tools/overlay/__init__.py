"""The map drawn into recorded images: video, sheet, residuals, report. Begin with `log` and `video`.

May import estimator.config and the layers below it.
"""
