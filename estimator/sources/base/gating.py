"""Tests on innovations: is one too large (chi-square), is their mean off (CUSUM)?"""

from models.messages import Array
from models.radius import chi_square

USUAL, SURE = 0.96, 0.9999  # shares of good readings: beyond the first a median is unusual, beyond the second a reading
gate = chi_square  # of nu^T S^-1 nu


def cusum(sums: tuple[float, ...], nu: Array, sigma: Array, slack: float) -> tuple[float, ...]:
    """One step of the two-sided CUSUM of normalised innovations (Page 1954).

        g+ <- max(0, g+ + nu/sigma - k),   g- <- max(0, g- - nu/sigma - k)

    sums: (g+ and g- of each component; () to begin); slack: k, in sigma.
    """
    if len(sums) != 2 * len(nu):
        sums = (0.0,) * (2 * len(nu))
    z: list[float] = (nu / sigma).tolist()
    return tuple([max(0.0, before + (side - slack)) for before, side in zip(sums, z + [-x for x in z], strict=True)])
