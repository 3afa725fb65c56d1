"""Filter of the camera-IMU calibration: normalised innovations for given extrinsics (Hol 2010, ch. 5).

State as models/state.py, n = board corner, z down; an image measures the board in c:

    t_co = -R_cb (R_nb^T p_n + p_bc),   R_co = R_cb R_nb^T R_no
    r = (t - t_co, log(R R_co^T)),   dr = -R_cb R_nb^T dp,   dr = (-R_cb [R_nb^T p_n]x theta, -R_cb theta)
    e = L^-1 r,   L L^T = S = H P H^T + C
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import sampling, so3
from models.imu import advance
from models.messages import Array
from models.state import E, X

_P, _T, _N = E.P.start, E.THETA.start, E.SIZE
_V, _G, _A = E.V.start, E.BG.start, E.BA.start
_XP, _XV, _XQ, _XG, _XA = X.P.start, X.V.start, X.Q.start, X.BG.start, X.BA.start


@njit(cache=True)
def innovations(
    x: Array, P: Array, from_ns: int, t_ns: NDArray[np.int64], u: Array, shutter_ns: NDArray[np.int64],
    R_co: Array, t_co: Array, C: Array, R_no: Array, R_bc: Array, p_bc: Array, c: Array,
) -> Array:  # fmt: skip
    """Innovations (M, 6) of board poses R_co (M, 3, 3), t_co (M, 3), C (M, 6, 6); NaN on failure.

    x (16,), P (15, 15): at from_ns, changed in place; t_ns, u (K, 6): IMU; shutter_ns (M,) increasing, > from_ns; R_no: board to
    n; R_bc, p_bc: camera on body; c: models.imu.constants.
    """
    out = np.full((shutter_ns.shape[0], 6), np.nan)
    none, nothing = np.empty(0), np.empty((0, 0))
    R_cb = np.ascontiguousarray(R_bc.T)
    H = np.zeros((6, _N))
    identity, unknown = np.eye(_N), np.zeros((t_ns.shape[0], sampling.SIZE))
    for k in range(shutter_ns.shape[0]):
        i = int(np.searchsorted(t_ns, from_ns, side="right"))
        if not advance(x, P, nothing, t_ns, u, unknown, t_ns.shape[0], i, from_ns, shutter_ns[k], c, none, none):
            return out
        from_ns = shutter_ns[k]
        R_bn = np.ascontiguousarray(so3.matrix(x[_XQ:_XG]).T)
        R_cn = R_cb @ R_bn
        p_b = R_bn @ x[_XP:_XV]
        r = np.empty(6)
        r[:3] = t_co[k] + R_cb @ (p_b + p_bc)
        predicted = R_cn @ R_no
        r[3:] = so3.quat_log(so3.from_matrix(np.ascontiguousarray(R_co[k] @ predicted.T)))
        H[:3, _P : _P + 3] = -R_cn
        H[:3, _T : _T + 3] = -R_cb @ so3.skew(p_b)
        H[3:, _T : _T + 3] = -R_cb
        PHt = P @ H.T
        S = H @ PHt + C[k]
        L = np.linalg.cholesky(0.5 * (S + S.T))
        out[k] = np.linalg.solve(L, r)
        K = np.ascontiguousarray(np.linalg.solve(S, np.ascontiguousarray(PHt.T)).T)
        dx = K @ r
        IKH = identity - K @ H
        P[:] = IKH @ P @ IKH.T + K @ C[k] @ K.T
        x[_XP:_XV] += dx[_P : _P + 3]
        x[_XV:_XQ] += dx[_V : _V + 3]
        x[_XQ:_XG] = so3.normalise(so3.multiply(x[_XQ:_XG], so3.quat_exp(dx[_T : _T + 3])))
        x[_XG:_XA] += dx[_G : _G + 3]
        x[_XA:] += dx[_A:]
    return out
