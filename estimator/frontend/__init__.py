"""The visual front-end: camera images -> requests with a prior -> landmark fixes.

    requests (pairs, prior) -> processor (recognise, locate, draw) -> LandmarkFix, VisionReport

Begin with `requests` and `processor`. May import estimator.map_files, estimator.publish, logs, calib, vision and models.
"""
