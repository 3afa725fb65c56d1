"""The visual front-end: camera images become requests with a prior, requests become landmark fixes.

    requests (pairs, prior) -> processor (recognise, locate, draw) -> LandmarkFix, VisionReport

The daemon runs `processor` in another process, a replay in its own; both get the same answers, because the request is in the log.
Begin with `requests` and `processor`. May import estimator.map_files, estimator.publish, logs, calib, vision and models.
"""
