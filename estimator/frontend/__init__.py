"""The visual front-end: images to requests with a prior to landmark fixes.

Begin with `requests` and `processor`. May import estimator.map_files, estimator.publish, logs, calib, vision and models.
"""
