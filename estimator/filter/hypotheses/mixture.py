"""Covariance of the mixture of hypotheses about the leading state.

    P = f sum w_k (P_k + d_k d_k^T / f),   d_k = x_k (-) x,   w_k ~ exp(weight + benefit)

f: the variance of unit weight. (Bar-Shalom, Li, Kirubarajan 2001, 1.4.16.)
"""

import math

from numba import njit

from estimator.filter.hypotheses.hypothesis import Hypothesis
from models.messages import Array
from models.state import E, local

_N, _T = E.SIZE, E.THETA.start  # compiled code reads plain integers
_OF_STATE = (slice(0, _N), slice(0, _N))  # of P
_HALF_TURN = 3.14  # rad


def covariance(members: list[Hypothesis]) -> Array:
    """Of the leading state's error, (15, 15), over all that show; the first leads."""
    lead, (first, *others) = members[0].filter, shares(members)
    total, root = first * lead.cov[_OF_STATE], math.sqrt(lead.variance_factor)
    for share, member in zip(others, members[1:], strict=True):
        if share:
            mix(total, share, member.filter.cov, lead.x, member.filter.x, root)
    if lead.variance_factor > 1.0:
        scale(total, lead.variance_factor)
    return total


def shares(members: list[Hypothesis]) -> list[float]:
    """w_k of each member, which sum to 1; 0 of one that does not show."""
    if len(members) == 1:  # most of the time
        return [1.0]
    lead = members[0]
    weights = [math.exp(m.weight + m.benefit) if m is lead or m.shows_beside(lead) else 0.0 for m in members]
    whole = weights[0] + sum(weights[1:])
    return [weight / whole for weight in weights]


def ln_sum(terms: list[float]) -> float:
    """ln of the sum of exp(terms)."""
    top = max(terms)
    return top if len(terms) == 1 else top + math.log(sum([math.exp(term - top) for term in terms]))


@njit(cache=True, error_model="numpy")
def scale(cov: Array, factor: float) -> None:
    """P <- f P (15, 15), in place; an attitude has no sigma beyond half a turn."""
    for i in range(_N):
        for j in range(_N):
            cov[i, j] *= factor
    sigma = math.sqrt(max(cov[_T, _T], cov[_T + 1, _T + 1], cov[_T + 2, _T + 2]))
    if sigma > _HALF_TURN:
        for i in range(_T, _T + 3):
            for j in range(_N):
                cov[i, j] *= _HALF_TURN / sigma
        for i in range(_N):
            for j in range(_T, _T + 3):
                cov[i, j] *= _HALF_TURN / sigma


@njit(cache=True)
def mix(total: Array, weight: float, cov: Array, lead: Array, x: Array, root: float) -> None:
    """Add weight (P + d d^T / f) of the 15 error states to total (15, 15), in place; cov: (n, n), d = x (-) lead, root: f^1/2."""
    off = local(lead, x)
    for i in range(_N):
        off[i] /= root
    for i in range(_N):
        for j in range(_N):
            total[i, j] += weight * (cov[i, j] + off[i] * off[j])
