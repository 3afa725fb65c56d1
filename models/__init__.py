"""The physics: messages, rotations, frames, the state table, motion and measurement models, simulation.

Pure functions on arrays: no I/O, no clock, no threads. May import numpy, scipy, numba, pymap3d and msgspec, nothing else of ours.

Conventions in one breath (docs/conventions.md has the drawing):
frames n = local NED at the map origin, b = body FRD at the IMU, e = ECEF; `x_a = R_ab @ x_b`;
Hamilton quaternions `q_nb_wxyz`; attitude error local (right): `R_nb = R_hat @ exp(theta)`;
time is `t_ns: int`, the time of validity; SI units and radians inside.
"""
