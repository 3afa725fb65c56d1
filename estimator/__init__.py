"""The estimator: an error-state Kalman filter for rare, late or missing absolute fixes.

    fusion.Fusion.handle(message) -> outputs

Below `fusion` there is no I/O, no clock and no thread. May import logs, calib, vision and models.
"""

import os

# Before numpy is loaded. Matrices here are small: a second thread gains nothing, costs milliseconds wherever it has to wait for a
# busy core, and would let the number of cores decide how sums are rounded. Whoever sets the variable has his way.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
