"""The World Magnetic Model 2025 (NOAA/NCEI and BGS; Chulliat et al. 2025).

    V = a sum_n (a/r)^(n+1) sum_m (g_nm cos m lambda + h_nm sin m lambda) P_nm(sin phi'),   B = -grad V,   a = 6371200 m

P_nm: Schmidt semi-normalised; g(t) = g + (t - 2025) dg/dt. Sigma of the crust: 138 nT, inclination 0.2 deg, declination
sqrt(0.26^2 + (5417 nT / H)^2) deg, H horizontal strength.
"""

import math
from functools import lru_cache
from typing import Final

import numpy as np

from models.frames import Origin
from models.messages import Array

_RADIUS_M: Final = 6_371_200.0
_A: Final = 6_378_137.0  # WGS-84
_E2: Final = 6.69437999014e-3
_DEGREE: Final = 12
_EPOCH: Final = 2025.0
_YEARS: Final = (2010.0, 2040.0)  # beyond, the clock was never set: that of the middle of the model's time is taken
_MIDDLE: Final = 2027.5
_YEAR_NS: Final = 365.2425 * 86_400e9
_LEAST_COS: Final = 1e-9  # at the poles


def year_of(t_ns: int) -> float:
    """The decimal year of a time since 1970."""
    return 1970.0 + t_ns / _YEAR_NS


@lru_cache(maxsize=64)
def field_n(origin: Origin, year: float) -> tuple[float, float, float]:
    """B at n's origin, tesla; year: rounded to a day (cache)."""
    return tuple(_field(origin, year if _YEARS[0] <= year <= _YEARS[1] else _MIDDLE).tolist())


def _field(origin: Origin, year: float) -> Array:
    lat, lon = math.radians(origin.lat_deg), math.radians(origin.lon_deg)
    s, c = math.sin(lat), math.cos(lat)
    curvature = _A / math.sqrt(1.0 - _E2 * s * s)
    outward, up = (curvature + origin.alt_m) * c, (curvature * (1.0 - _E2) + origin.alt_m) * s
    r = math.hypot(outward, up)
    sin_p, cos_p = up / r, max(outward / r, _LEAST_COS)
    p, slope = _legendre(sin_p, cos_p)
    north = east = down = 0.0
    for n, m, g, h, dg, dh in _TABLE:
        k, j = int(n), int(m)
        at_g, at_h = g + (year - _EPOCH) * dg, h + (year - _EPOCH) * dh
        cos_m, sin_m = math.cos(j * lon), math.sin(j * lon)
        size = (_RADIUS_M / r) ** (k + 2)
        along, across = at_g * cos_m + at_h * sin_m, at_g * sin_m - at_h * cos_m
        north -= size * along * slope[k, j]
        east += size * j * across * p[k, j] / cos_p
        down -= size * (k + 1) * along * p[k, j]
    turn = math.atan2(sin_p, cos_p) - lat  # geocentric down against the ellipsoid's
    cos_t, sin_t = math.cos(turn), math.sin(turn)
    return 1e-9 * np.array([north * cos_t - down * sin_t, east, north * sin_t + down * cos_t])


def _legendre(s: float, c: float) -> tuple[Array, Array]:
    """P_nm(s) and dP_nm / d phi, (13, 13), s = sin phi, c = cos phi:

    P_nn = sqrt((2n-1) / 2n) c P_n-1,n-1  (n > 1),   P_nm = ((2n-1) s P_n-1,m - sqrt((n-1)^2 - m^2) P_n-2,m) / sqrt(n^2 - m^2)
    """
    p, slope = np.zeros((_DEGREE + 1, _DEGREE + 1)), np.zeros((_DEGREE + 1, _DEGREE + 1))
    p[0, 0] = 1.0
    for n in range(1, _DEGREE + 1):
        scale = math.sqrt((2 * n - 1) / (2 * n)) if n > 1 else 1.0
        p[n, n] = scale * c * p[n - 1, n - 1]
        slope[n, n] = scale * (c * slope[n - 1, n - 1] - s * p[n - 1, n - 1])
        for m in range(n):
            before = math.sqrt((n - 1) ** 2 - m * m)
            two, slope_two = (p[n - 2, m], slope[n - 2, m]) if n > 1 else (0.0, 0.0)
            norm = math.sqrt(n * n - m * m)
            p[n, m] = ((2 * n - 1) * s * p[n - 1, m] - before * two) / norm
            slope[n, m] = ((2 * n - 1) * (c * p[n - 1, m] + s * slope[n - 1, m]) - before * slope_two) / norm
    return p, slope


# n, m, g_nm, h_nm [nT], dg/dt, dh/dt [nT a year]
_COEFFICIENTS: Final = """
 1  0  -29351.8      0.0   12.0    0.0
 1  1   -1410.8   4545.4    9.7  -21.5
 2  0   -2556.6      0.0  -11.6    0.0
 2  1    2951.1  -3133.6   -5.2  -27.7
 2  2    1649.3   -815.1   -8.0  -12.1
 3  0    1361.0      0.0   -1.3    0.0
 3  1   -2404.1    -56.6   -4.2    4.0
 3  2    1243.8    237.5    0.4   -0.3
 3  3     453.6   -549.5  -15.6   -4.1
 4  0     895.0      0.0   -1.6    0.0
 4  1     799.5    278.6   -2.4   -1.1
 4  2      55.7   -133.9   -6.0    4.1
 4  3    -281.1    212.0    5.6    1.6
 4  4      12.1   -375.6   -7.0   -4.4
 5  0    -233.2      0.0    0.6    0.0
 5  1     368.9     45.4    1.4   -0.5
 5  2     187.2    220.2    0.0    2.2
 5  3    -138.7   -122.9    0.6    0.4
 5  4    -142.0     43.0    2.2    1.7
 5  5      20.9    106.1    0.9    1.9
 6  0      64.4      0.0   -0.2    0.0
 6  1      63.8    -18.4   -0.4    0.3
 6  2      76.9     16.8    0.9   -1.6
 6  3    -115.7     48.8    1.2   -0.4
 6  4     -40.9    -59.8   -0.9    0.9
 6  5      14.9     10.9    0.3    0.7
 6  6     -60.7     72.7    0.9    0.9
 7  0      79.5      0.0   -0.0    0.0
 7  1     -77.0    -48.9   -0.1    0.6
 7  2      -8.8    -14.4   -0.1    0.5
 7  3      59.3     -1.0    0.5   -0.8
 7  4      15.8     23.4   -0.1    0.0
 7  5       2.5     -7.4   -0.8   -1.0
 7  6     -11.1    -25.1   -0.8    0.6
 7  7      14.2     -2.3    0.8   -0.2
 8  0      23.2      0.0   -0.1    0.0
 8  1      10.8      7.1    0.2   -0.2
 8  2     -17.5    -12.6    0.0    0.5
 8  3       2.0     11.4    0.5   -0.4
 8  4     -21.7     -9.7   -0.1    0.4
 8  5      16.9     12.7    0.3   -0.5
 8  6      15.0      0.7    0.2   -0.6
 8  7     -16.8     -5.2   -0.0    0.3
 8  8       0.9      3.9    0.2    0.2
 9  0       4.6      0.0   -0.0    0.0
 9  1       7.8    -24.8   -0.1   -0.3
 9  2       3.0     12.2    0.1    0.3
 9  3      -0.2      8.3    0.3   -0.3
 9  4      -2.5     -3.3   -0.3    0.3
 9  5     -13.1     -5.2    0.0    0.2
 9  6       2.4      7.2    0.3   -0.1
 9  7       8.6     -0.6   -0.1   -0.2
 9  8      -8.7      0.8    0.1    0.4
 9  9     -12.9     10.0   -0.1    0.1
10  0      -1.3      0.0    0.1    0.0
10  1      -6.4      3.3    0.0    0.0
10  2       0.2      0.0    0.1   -0.0
10  3       2.0      2.4    0.1   -0.2
10  4      -1.0      5.3   -0.0    0.1
10  5      -0.6     -9.1   -0.3   -0.1
10  6      -0.9      0.4    0.0    0.1
10  7       1.5     -4.2   -0.1    0.0
10  8       0.9     -3.8   -0.1   -0.1
10  9      -2.7      0.9   -0.0    0.2
10 10      -3.9     -9.1   -0.0   -0.0
11  0       2.9      0.0    0.0    0.0
11  1      -1.5      0.0   -0.0   -0.0
11  2      -2.5      2.9    0.0    0.1
11  3       2.4     -0.6    0.0   -0.0
11  4      -0.6      0.2    0.0    0.1
11  5      -0.1      0.5   -0.1   -0.0
11  6      -0.6     -0.3    0.0   -0.0
11  7      -0.1     -1.2   -0.0    0.1
11  8       1.1     -1.7   -0.1   -0.0
11  9      -1.0     -2.9   -0.1    0.0
11 10      -0.2     -1.8   -0.1    0.0
11 11       2.6     -2.3   -0.1    0.0
12  0      -2.0      0.0    0.0    0.0
12  1      -0.2     -1.3    0.0   -0.0
12  2       0.3      0.7   -0.0    0.0
12  3       1.2      1.0   -0.0   -0.1
12  4      -1.3     -1.4   -0.0    0.1
12  5       0.6     -0.0   -0.0   -0.0
12  6       0.6      0.6    0.1   -0.0
12  7       0.5     -0.1   -0.0   -0.0
12  8      -0.1      0.8    0.0    0.0
12  9      -0.4      0.1    0.0   -0.0
12 10      -0.2     -1.0   -0.1   -0.0
12 11      -1.3      0.1   -0.0    0.0
12 12      -0.7      0.2   -0.1   -0.1
"""
_TABLE: Final = np.array(_COEFFICIENTS.split(), dtype=float).reshape(-1, 6).tolist()
