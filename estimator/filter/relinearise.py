"""The aligning stretch run again about its trajectory x_k: an iterated Kalman smoother (docs/estimator.md, section 6).

    d_k+1 = c_k + Phi_k d_k + w_k,   c_k = f(x_k) (-) x_k+1,   d_0 ~ N(x_prior (-) x_0, P_prior),   nu_k = H_k d_k + v_k

d_k = x_true,k (-) x_k; the trajectory moves by E[d_k | all nu] until its end stays: Gauss-Newton (Bell 1994), with the first
run's prior. Estimated errors s of air data, from old x, P to new x^, P^:

    s^ = s + C (x^ (-) x),   P^_sx = C P^_xx,   P^_ss = P_ss - C P_xs + C P^_xx C^T,   C = P_sx P_xx^-1
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import msgspec
import numpy as np

from estimator.filter.eskf import Eskf, inject
from estimator.filter.hypotheses import innovation
from estimator.filter.imu_buffer import ImuBuffer
from estimator.filter.slow_errors import NO_SLOW_ERRORS, SlowErrors
from estimator.sources.air.wind import OF_AIR, WIND
from estimator.sources.base.aid import Aid
from estimator.sources.base.gating import gate
from models import cholesky, imu, so3
from models.measurements import Measurement, mahalanobis
from models.messages import Array
from models.state import E, X, carried, local, retract

_PASSES = 8
# Squared moves of a pass, per state, in units of P: by less it has converged, by more it says something new.
_STAYS, _CHANGES = 0.01, 0.05
_LEARNT = 0.7  # an uncertainty that has fallen by this factor is worth another run
_CONFIRMED = 1.25  # times the stretch at the last change
_GROWN, _FEW = 1 / 16, 16  # but not before the stretch has grown by this share, where it is longer than a few measurements
_MOST, _LONGEST_NS = 600, 120_000_000_000  # measurements and time of a stretch
_ATTITUDE_KNOWN = math.radians(1.0)  # the linear model then holds
_NONLINEAR = slice(E.THETA.start, E.SIZE)  # errors that are multiplied by others: attitude and biases
_ATTITUDE = slice(0, 3)  # of these


class Taken(NamedTuple):
    """A measurement of the stretch; gyro_b: raw rate; follows: fused at any distance."""

    aid: Aid
    z: Measurement
    gyro_b: Array
    follows: bool = False


@dataclass(frozen=True, slots=True)
class Stretch:
    """x (16,) and cov (n, n) at the start, and the measurements since.

    Of the last run: path; sigma (9,) of attitude and biases; run_at, moved_at: number of measurements, of those with an effect.
    """

    t_ns: int
    x: Array
    cov: Array
    slow: SlowErrors = NO_SLOW_ERRORS
    taken: tuple[Taken, ...] = ()
    path: tuple[Array, ...] = ()
    sigma: Array | None = None
    run_at: int = 0
    moved_at: int = 0

    @classmethod
    def of(cls, known: Eskf) -> "Stretch":
        """A stretch that begins with a filter's state."""
        return cls(known.t_ns, known.x.copy(), known.cov.copy(), known.slow)

    def also(self, aid: Aid, z: Measurement, gyro_b: Array, *, follows: bool = False) -> "Stretch":
        """With one more measurement, unless its zero is unknown (a barometer's is found again)."""
        if any(slow.walk is not None for slow in aid.slow_errors):
            return self
        return replace(self, taken=(*self.taken, Taken(aid, z, gyro_b, follows)))

    @property
    def has_grown(self) -> bool:
        """Whether another run may say something else than the last one."""
        return len(self.taken) <= _FEW or len(self.taken) > self.run_at * (1.0 + _GROWN)

    def due(self, found: Eskf) -> bool:
        """Whether enough was learnt since the last run."""
        return self.has_grown and (self.sigma is None or bool((_sigma(found) < _LEARNT * self.sigma).any()))

    @property
    def is_confirmed(self) -> bool:
        """No run has changed the filter for a fifth of the stretch."""
        return self.run_at >= _CONFIRMED * self.moved_at > 0

    @property
    def is_settled(self) -> bool:
        """Attitude known, no change by a run for half of the stretch."""
        known = self.sigma is not None and bool((self.sigma[_ATTITUDE] < _ATTITUDE_KNOWN).all())
        return known and self.run_at >= 2 * self.moved_at > 0

    @property
    def has_followed(self) -> bool:
        """Whether it fused a measurement at any distance."""
        return any(taken.follows for taken in self.taken)

    def is_long(self, t_ns: int) -> bool:
        """Too long for another run."""
        return len(self.taken) >= _MOST or t_ns - self.t_ns > _LONGEST_NS


@dataclass(frozen=True, slots=True)
class Link:
    """Error transition from the measurement before: Phi (15, 15), and the prediction."""

    phi: Array
    mean: Array
    cov: Array


def relinearise(stretch: Stretch, found: Eskf, samples: ImuBuffer) -> tuple[Eskf, Stretch] | None:
    """The relinearised filter, and the stretch with the run.

    None: no convergence, or to a path that the newest reading, which the filter has fused, contradicts.
    """
    path = _extended(stretch, found, samples) if stretch.path else _first_path(stretch, found, samples)
    before = None
    for _ in range(_PASSES):
        end, path, is_near = _run(stretch, path, samples, found)
        if not end.sound:
            return None
        stays = before is not None and _distance2(end, before) < _STAYS
        before = end.x
        if stays:
            if not is_near:
                return None
            changed, count = _distance2(end, found.x) >= _CHANGES or not stretch.path, len(stretch.taken)
            moved_at = count if changed else stretch.moved_at
            end = with_estimated(end, found, stretch)
            return end, replace(stretch, path=tuple(path), sigma=_sigma(end), run_at=count, moved_at=moved_at)
    return None


def with_estimated(end: Eskf, found: Eskf, stretch: Stretch) -> Eskf:
    """Add to a run's result the air sensors' blocks of `found` that the stretch does not carry.

    Zeros (barometer) are found again.
    """
    if WIND not in found.slow.columns:
        return end
    carried_by = {slow.block for taken in stretch.taken for slow in taken.aid.slow_errors}
    blocks = [b for b in found.slow.columns if b.endswith(OF_AIR) and b not in carried_by]
    for block in (b for b in blocks if b in end.slow.columns):
        end.forget(block)
    x, kept = slice(0, E.SIZE), np.concatenate([np.r_[found.slow.columns[b]] for b in blocks])
    sigma, off = np.sqrt(np.diag(found.cov)[x]), local(found.x, end.x)
    p_xs = found.cov[x, kept]
    by = np.linalg.solve(found.cov[x, x] / np.outer(sigma, sigma), p_xs / sigma[:, np.newaxis]).T / sigma
    by_end = by.copy()  # of an error about the new attitude
    by_end[:, E.THETA] = by[:, E.THETA] @ so3.right_jacobian_inverse(off[E.THETA])
    cross = by_end @ end.cov[x]
    own = found.cov[np.ix_(kept, kept)] - by @ p_xs + cross[:, x] @ by_end.T
    end.cov = np.block([[end.cov, cross.T], [cross, own]])
    cholesky.symmetrise(end.cov)
    shift = np.concatenate([np.zeros(len(end.slow.mean)), by @ off])
    end.slow = end.slow.joined(blocks, found.slow).moved(shift)
    return end


def _distance2(end: Eskf, x: Array) -> float:
    sigma = np.sqrt(np.diag(end.cov)[: E.SIZE])
    off = local(end.x, x) / sigma
    return float(off @ np.linalg.solve(end.cov[: E.SIZE, : E.SIZE] / np.outer(sigma, sigma), off)) / E.SIZE


def _first_path(stretch: Stretch, found: Eskf, samples: ImuBuffer) -> list[Array]:
    start = stretch.x.copy()
    start[X.BG], start[X.BA] = found.x[X.BG], found.x[X.BA]
    ended = _moved(stretch.t_ns, start, found.t_ns, samples, found.constants)
    start[X.Q] = so3.multiply(so3.multiply(found.x[X.Q], so3.conjugate(ended[X.Q])), start[X.Q])
    return _extended(replace(stretch, path=(start,)), found, samples)


def _extended(stretch: Stretch, found: Eskf, samples: ImuBuffer) -> list[Array]:
    path = list(stretch.path)
    known = len(path) - 1
    t_ns = stretch.taken[known - 1].aid.t_ns if known else stretch.t_ns
    for taken in stretch.taken[known:]:
        path.append(_moved(t_ns, path[-1], taken.aid.t_ns, samples, found.constants))
        t_ns = taken.aid.t_ns
    return path


def _moved(t_ns: int, x: Array, to_ns: int, samples: ImuBuffer, constants: Array) -> Array:
    return imu.moved(x, samples.t_ns, samples.u, samples.count, samples.first_after(t_ns), t_ns, to_ns, constants)


def _run(stretch: Stretch, path: list[Array], samples: ImuBuffer, like: Eskf) -> tuple[Eskf, list[Array], bool]:
    """Its end, the path moved by all readings, and whether the newest one is near it."""
    dx = local(path[0], stretch.x)
    cov = carried(stretch.cov, so3.right_jacobian_inverse(dx[E.THETA]))
    run = Eskf(stretch.t_ns, path[0].copy(), cov, like.constants, stretch.slow, like.variance_factor)
    means, covs, links, predicted = [dx], [run.cov[: E.SIZE, : E.SIZE].copy()], [], dx
    for x, taken in zip(path[1:], stretch.taken, strict=True):
        index, to_ns = samples.first_after(run.t_ns), taken.aid.t_ns
        phi = np.eye(E.SIZE)
        run.propagate(samples, index, to_ns, phi)
        off = local(x, run.x)
        jacobian = so3.right_jacobian_inverse(off[E.THETA])
        phi[E.THETA] = jacobian @ phi[E.THETA]
        run.x, run.cov, dx = x.copy(), carried(run.cov, jacobian), off + phi @ dx
        links.append(Link(phi, dx, run.cov[: E.SIZE, : E.SIZE].copy()))
        predicted, dx = dx, _fuse(run, dx, taken)
        means.append(dx)
        covs.append(run.cov[: E.SIZE, : E.SIZE].copy())
    smoothed = [retract(x, mean) for x, mean in zip(path, _smoothed(means, covs, links), strict=True)]
    run.sound = inject(run.x, run.cov, dx)
    return run, smoothed, dx is not predicted


def _fuse(run: Eskf, dx: Array, taken: Taken) -> Array:
    seen = innovation(run, taken.aid, taken.z, taken.gyro_b)
    nu = seen.nu - seen.h[:, : E.SIZE] @ dx
    distance2, _ = mahalanobis(nu, seen.s)
    if distance2 > gate(taken.aid.rules.gate_probability, len(nu)) and not taken.follows:
        return dx
    return dx + run.correct(msgspec.structs.replace(seen, nu=nu))


def _smoothed(means: list[Array], covs: list[Array], links: list[Link]) -> list[Array]:
    """Backward (Rauch, Tung, Striebel 1965): d_k + P_k Phi_k^T P_k+1|k^-1 (d_k+1|N - d_k+1|k); without slow errors."""
    after = means[-1]
    result = [after]
    for mean, cov, link in zip(means[-2::-1], covs[-2::-1], links[::-1], strict=True):
        sigma = np.sqrt(np.diag(link.cov))
        gained = np.linalg.solve(link.cov / np.outer(sigma, sigma), (after - link.mean) / sigma) / sigma
        after = mean + cov @ (link.phi.T @ gained)
        result.append(after)
    return result[::-1]


def _sigma(found: Eskf) -> Array:
    sigma: Array = np.sqrt(np.diag(found.cov)[_NONLINEAR])
    return sigma
