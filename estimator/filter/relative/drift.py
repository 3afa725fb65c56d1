"""Drift of an odometry: a velocity d in n, considered, widened by what an innovation makes probable (docs/odometry.md).

    p = pi L_1 / (pi L_1 + (1 - pi) L_0),   L_0 = N(nu; 0, S),   L_1 = N(nu; 0, S + sigma_b^2 dt^2 I)
    P_dd <- P_dd + max(p - pi, 0) u u^T,    u = R_0 nu / dt

pi: share of false increments; sigma_b: of a drift that begins. An innovation that makes no drift more probable widens nothing.
"""

import math

import numpy as np

from estimator.filter.eskf import Eskf, Innovation
from estimator.sources.base.learnt_noise import BEGINS_M_S
from estimator.sources.odometry import DRIFT_M_S, FADES_S, OdometryAid, drift_block
from models.measurements import mahalanobis
from models.messages import Array
from models.relative_pose import RelativePose
from models.state import XYZ, E

WORTH_SAYING_M_S = 0.25
_MOST = 50.0  # ln
_NOTHING_M2_S2 = 1e-6


def suspect(eskf: Eskf, seen: Innovation, aid: OdometryAid, z: RelativePose, share: float) -> bool:
    """Widen d by the innovation of a translation; share: pi, or 1 for a known drift. Whether P has changed."""
    at, rows = eskf.slow.columns[drift_block(aid.topic)], z.rows < XYZ
    nu, s, j = seen.nu[rows], seen.s[np.ix_(rows, rows)], seen.h[rows, at]  # J = dt R_0^T
    if not len(nu):
        return False
    u = j.T @ nu / float(np.sum(j[0] ** 2))
    p = share if share == 1.0 else _posterior(nu, s, s + BEGINS_M_S**2 * j @ j.T, share) - share
    if p * float(u @ u) < _NOTHING_M2_S2:
        return False
    eskf.cov[at, at] += p / eskf.variance_factor * np.outer(u, u)
    return True


def _posterior(nu: Array, s: Array, wider: Array, share: float) -> float:
    (near, logdet), (far, wider_logdet) = mahalanobis(nu, s), mahalanobis(nu, wider)
    odds = share / (1.0 - share) * math.exp(min(0.5 * (near + logdet - far - wider_logdet), _MOST))
    return odds / (1.0 + odds)


def fade(eskf: Eskf, block: str, seconds: float) -> None:
    """d <- a d, P_dd <- a^2 P_dd + (1 - a^2) sigma_d^2 I, a = exp(-dt / 10 s), with positions."""
    if block not in eskf.slow.columns:
        return
    at, a = eskf.slow.columns[block], math.exp(-seconds / FADES_S)
    eskf.cov[at] *= a
    eskf.cov[:, at] *= a
    eskf.cov[at, at] += (1.0 - a * a) * DRIFT_M_S**2 * np.eye(at.stop - at.start)


def hide(eskf: Eskf, block: str, sigma_m_s: float) -> None:
    """P_dd,ii <- max(P_dd,ii, sigma^2): a drift of sigma changes the velocity by no more than increments do."""
    if block not in eskf.slow.columns:
        return
    at = eskf.slow.columns[block]
    more = np.diag(np.maximum(sigma_m_s**2 / eskf.variance_factor - eskf.cov[at, at].diagonal(), 0.0))
    eskf.cov[at, at] += more
    eskf.cov[E.V, E.V] += more
    eskf.cov[E.V, at] -= more
    eskf.cov[at, E.V] -= more


def sigma_m_s(eskf: Eskf, block: str) -> float:
    """sqrt(tr f P_dd)."""
    at = eskf.slow.columns[block]
    return math.sqrt(eskf.variance_factor * float(np.trace(eskf.cov[at, at])))
