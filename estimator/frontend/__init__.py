"""The visual front-end: images -> requests with prior -> landmark fixes.

Begin with `requests`. May import estimator.map_files, estimator.publish, logs, calib, vision, models.
"""
