"""An error-state Kalman filter for rare, late or missing fixes.

    fusion.Fusion.handle(message) -> outputs

No I/O, clock or thread below `fusion`. May import logs, calib, vision, models.
"""

import os

# Before numpy is loaded. Matrices here are small: a second thread gains nothing, costs milliseconds wherever it has to wait for a
# busy core, and would let the number of cores decide how sums are rounded. Whoever sets the variable has his way.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
