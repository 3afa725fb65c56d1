"""The covariance of the hypotheses together: that of the mixture about the leading state.

    P = f sum w_k (P_k + d_k d_k^T / f),   d_k = x_k (-) x,   w_k ~ exp(weight + benefit)

f: the variance of unit weight. (Bar-Shalom, Li, Kirubarajan 2001, Estimation with Applications to Tracking and Navigation,
1.4.16.)
"""

import math

from numba import njit

from estimator.filter.hypotheses.hypothesis import Hypothesis
from models.messages import Array
from models.state import E, local

_N = E.SIZE  # compiled code reads plain integers
_OF_STATE = (slice(0, _N), slice(0, _N))  # of P
_HALF_TURN = 3.14  # rad


def covariance(members: list[Hypothesis]) -> Array:
    """Of the leading state's error, (15, 15), over all that show; the first leads."""
    lead = members[0].filter
    others = [m for m in members[1:] if m.shows_beside(members[0])] if len(members) > 1 else ()
    if not others:  # most of the time
        cov, factor = lead.cov[_OF_STATE], lead.variance_factor
        return cov.copy() if factor == 1.0 else _scaled(cov, factor)
    first, *weights = (math.exp(m.weight + m.benefit) for m in (members[0], *others))
    whole, root = first + sum(weights), math.sqrt(lead.variance_factor)
    total = first / whole * lead.cov[_OF_STATE]
    for weight, member in zip(weights, others, strict=True):
        _mix(total, weight / whole, member.filter.cov, lead.x, member.filter.x, root)
    return _scaled(total, lead.variance_factor)


def ln_sum(terms: list[float]) -> float:
    """ln of the sum of exp(terms)."""
    top = max(terms)
    return top + math.log(sum(math.exp(term - top) for term in terms))


def _scaled(cov: Array, factor: float) -> Array:
    """f P (15, 15); an attitude has no sigma beyond half a turn."""
    if factor == 1.0:
        return cov
    scaled = factor * cov
    sigma = math.sqrt(max(scaled.diagonal()[E.THETA].tolist()))
    if sigma > _HALF_TURN:
        scaled[E.THETA] *= _HALF_TURN / sigma
        scaled[:, E.THETA] *= _HALF_TURN / sigma
    return scaled


@njit(cache=True)
def _mix(total: Array, weight: float, cov: Array, lead: Array, x: Array, root: float) -> None:
    """Add weight (P + d d^T / f) of the 15 error states to total (15, 15), in place; cov: (n, n), d = x (-) lead, root: f^1/2."""
    off = local(lead, x)
    for i in range(_N):
        off[i] /= root
    for i in range(_N):
        for j in range(_N):
            total[i, j] += weight * (cov[i, j] + off[i] * off[j])
