"""What an IMU leaves out between samples, learnt from its samples (docs/estimator.md, section 2).

    m_j = E |x(t - T_j) - 2 x(t) + x(t + T_j)|^2 / 6,    D_j = T_j m_j,    T_j = 2^j h
    E_j+1 = E_j + D_j                                    (E_j: of lines over T_j; between 2^j and 2^j+1 steps linear in n)
    m = m_0 - (m_1 - m_0) / 15,    E_0 = (h m - q) s^2,    s = 2 m_1 / m_0 - 1, within 0 and 1

m_j: variance of equivalent white samples; D_j: density added to the integral, rad^2/s or m^2/s^3; E_0: unresolved motion; m:
noise (Richardson's extrapolation); q: the sensor's white density. m_1 < m_0: vibration near half the rate, which averaging
sensors suppress.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array

LEVELS = 6  # lags of 1, 2, 4 .. 32 steps: bridges 64, a gap of 0.1 s at 640 Hz
SIZE = 1 + 2 * LEVELS  # of what is known of a stream: h, then m_j of the gyroscope and of the accelerometer

_NS = 1e-9  # s per ns
_MEMORY_S = 5.0  # of the running means: vibration changes with the throttle
_LONGEST_S = 0.2  # lag; no gap as long is bridged
_OFF_MIDDLE = 0.125  # of the distance of its neighbours: a sample further from their middle is beside a gap
_GAP = 1.5  # steps


@njit(cache=True, error_model="numpy")
def learn(t_ns: NDArray[np.int64], u: Array, known: Array, begin: int, end: int) -> None:
    """Fill known[begin:end] (capacity, SIZE): row i from samples 0..i; t_ns (capacity,), u (capacity, 6).

    A row needs the one before and samples within twice the longest lag.
    """
    for i in range(begin, end):
        if i == 0:
            known[i] = 0.0
            continue
        row = known[i]
        for k in range(SIZE):
            row[k] = known[i - 1, k]
        step = (t_ns[i] - t_ns[i - 1]) * _NS
        gain = step / (_MEMORY_S + step)
        for j in range(LEVELS):
            middle, first = i - (1 << j), i - (2 << j)
            if first < 0:
                break
            span = (t_ns[i] - t_ns[first]) * _NS
            if span > 2.0 * _LONGEST_S:
                break
            s = (t_ns[middle] - t_ns[first]) * _NS / span
            if abs(s - 0.5) > _OFF_MIDDLE:
                continue
            if j == 0:
                row[0] += (0.5 * span - row[0]) * (gain if row[0] > 0.0 else 1.0)
            for sensor in range(2):
                square = 0.0
                for k in range(3 * sensor, 3 * sensor + 3):
                    off = u[middle, k] - u[first, k] - s * (u[i, k] - u[first, k])
                    square += off * off
                at = 1 + LEVELS * sensor + j
                row[at] += gain * (square * 4.0 / 18.0 - row[at])  # (2 off)^2 / 6, mean of three axes


@njit(cache=True, error_model="numpy")
def put(
    t_ns: NDArray[np.int64], u: Array, known: Array, k: int, end: int, stamp_ns: int,
    p: float, q: float, r: float, x: float, y: float, z: float,
) -> None:  # fmt: skip
    """Sample k is (p q r), rad/s, and (x y z), m/s^2, at stamp_ns; `learn` from there to `end`."""
    t_ns[k] = stamp_ns
    u[k, 0], u[k, 1], u[k, 2], u[k, 3], u[k, 4], u[k, 5] = p, q, r, x, y, z
    learn(t_ns, u, known, k, end)


@njit(cache=True, error_model="numpy")
def density(known: Array, sensor: int, span_s: float, psd: float) -> float:
    """Density left out by a line over span_s; known: (SIZE,), sensor: 0 gyroscope, 1 accelerometer, psd: q."""
    h, m = known[0], known[1 + LEVELS * sensor : 1 + LEVELS * (sensor + 1)]
    error = 0.0
    if h * m[0] > psd:
        rest = m[0] - max(0.0, m[1] - m[0]) / 15.0
        s = min(1.0, max(0.0, 2.0 * m[1] / m[0] - 1.0))
        error = max(0.0, h * rest - psd) * s * s
    if span_s > _GAP * h > 0.0:
        steps, lag = span_s / h, 1.0
        for j in range(LEVELS):
            if steps > lag:
                error += lag * h * m[j] * min(steps / lag - 1.0, 1.0)
            lag *= 2.0
    return error
