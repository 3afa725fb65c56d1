"""The map drawn into recorded images: video, contact sheet, residuals, images of a report. Begin with `log` and `video`.

May import estimator.config and the layers below it.
"""
