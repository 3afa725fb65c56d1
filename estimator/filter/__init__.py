"""The error-state Kalman filter with rewind.

    tracker (one state, one step) <- history (order by validity, exact rewind) <- fusion

Pure. Begin with `history`, `eskf`. May import estimator.sources, models.
"""
