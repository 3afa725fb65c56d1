"""The error-state Kalman filter, run again from a checkpoint for late measurements.

    tracker (one state, one step) <- history (order by validity, exact rewind) <- fusion

Pure: no I/O, no clock, no thread. Begin with `history` and `eskf`. May import estimator.sources and models.
"""
