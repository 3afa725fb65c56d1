"""The estimator proper: an error-state Kalman filter whose history is run again when a measurement comes late.

    tracker (one state, one step) <- history (order by validity, exact rewind) <- fusion
    eskf, kalman: prediction and update;  hypotheses, contradiction: outliers;  initialise, relinearise: the start

Pure: no I/O, no clock, no thread. `fusion` is its only user in flight. Begin with `history` and `eskf`.
May import estimator.sources and models.
"""
