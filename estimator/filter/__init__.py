"""The error-state Kalman filter, whose history is run again for a late measurement.

    tracker (one state, one step) <- history (order by validity, exact rewind) <- fusion
    eskf, kalman: prediction and update;  hypotheses, contradiction: outliers;  initialise, relinearise: the start

Pure: no I/O, no clock, no thread. Begin with `history` and `eskf`. May import estimator.sources and models.
"""
