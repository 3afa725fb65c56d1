"""Accuracy and consistency of arrays of associated rows.

Positions (n, 3) m, quaternions (n, 4) wxyz body -> map, errors true minus estimated, covariances (n, k, k); nan without rows.
"""

from dataclasses import dataclass
from typing import Literal, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from models.messages import Array
from models.radius import chi_square

Times: TypeAlias = NDArray[np.int64]
Indices: TypeAlias = NDArray[np.intp]
Mask: TypeAlias = NDArray[np.bool_]
AlignmentKind: TypeAlias = Literal["none", "yaw", "se3", "sim3"]


class Stats(msgspec.Struct, frozen=True):
    """RMS, mean, median, maximum of n magnitudes; nan for n = 0."""

    rmse: float
    mean: float
    median: float
    max: float
    n: int


def stats(magnitude: Array) -> Stats:
    """rmse = sqrt(sum |e_i|^2 / n) and others, of (n,) magnitudes or (n, k) vectors."""
    e: Array = np.linalg.norm(magnitude, axis=1) if magnitude.ndim == 2 else np.abs(magnitude)
    if not len(e):
        return Stats(np.nan, np.nan, np.nan, np.nan, 0)
    return Stats(float(np.sqrt(np.mean(e**2))), float(e.mean()), float(np.median(e)), float(e.max()), len(e))


@dataclass(frozen=True, slots=True)
class Alignment:
    """p_true = scale * R @ p_est + t."""

    R: Array
    t: Array
    scale: float = 1.0

    def positions(self, p: Array) -> Array:
        """Aligned positions, (n, 3)."""
        moved: Array = self.scale * p @ self.R.T + self.t
        return moved

    def attitudes(self, q_wxyz: Array) -> Array:
        """Aligned quaternions, (n, 4)."""
        return (Rotation.from_matrix(self.R) * rotation(q_wxyz)).as_quat(scalar_first=True)


def rotation(q_wxyz: Array) -> Rotation:
    """scipy's Rotation of (n, 4) quaternions wxyz."""
    return Rotation.from_quat(q_wxyz, scalar_first=True)


def align(p_est: Array, p_true: Array, kind: AlignmentKind = "se3") -> Alignment:
    """The motion that brings p_est nearest to p_true by least squares.

        min over (c, R, t) of  sum | p_true_i - c R p_est_i - t |^2                      (Umeyama 1991, eq. 40-43)
        R = U S V',  c = tr(D S) / var(p_est),  t = mean(p_true) - c R mean(p_est),  U D V' = cov(p_true, p_est)

    "yaw": R about z, c = 1 (Zhang & Scaramuzza 2018, III-C); "se3": c = 1; "sim3": all; "none": identity.
    """
    if kind == "none" or not len(p_est):
        return Alignment(np.eye(3), np.zeros(3))
    mean_est, mean_true = p_est.mean(axis=0), p_true.mean(axis=0)
    x, y = p_est - mean_est, p_true - mean_true
    cov = y.T @ x / len(x)
    scale = 1.0
    if kind == "yaw":
        R = Rotation.from_rotvec([0.0, 0.0, np.arctan2(cov[1, 0] - cov[0, 1], cov[0, 0] + cov[1, 1])]).as_matrix()
    else:
        u, d, vt = np.linalg.svd(cov)
        s = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
        R = u @ np.diag(s) @ vt
        variance = float((x**2).sum() / len(x))
        if kind == "sim3" and variance > 0.0:
            scale = float(d @ s) / variance
    return Alignment(R, mean_true - scale * R @ mean_est, scale)


def ate(p_est: Array, p_true: Array, kind: AlignmentKind = "none") -> Stats:
    """Absolute trajectory error |p_true_i - S p_est_i|, S by align(kind), m (Sturm et al. 2012, eq. 4-5)."""
    return stats(p_true - align(p_est, p_true, kind).positions(p_est))


def attitude_error(q_est_wxyz: Array, q_true_wxyz: Array) -> Array:
    """dtheta = log(R_true R_est'), (n, 3) rad about map axes."""
    error: Array = (rotation(q_true_wxyz) * rotation(q_est_wxyz).inv()).as_rotvec()
    return error


def path_length(p: Array) -> Array:
    """Distance travelled to each row, (n,) m."""
    steps = np.linalg.norm(np.diff(p, axis=0), axis=1)
    return np.concatenate([np.zeros(min(1, len(p))), np.cumsum(steps)])


def pairs_apart(coordinate: Array, delta: float, tolerance: float) -> tuple[Indices, Indices]:
    """For i the row j > i nearest to coordinate_i + delta within tolerance; coordinate: (n,) not decreasing."""
    n = len(coordinate)
    if n < 2:
        return np.empty(0, np.intp), np.empty(0, np.intp)
    goal = coordinate + delta
    j = np.clip(np.searchsorted(coordinate, goal), 1, n - 1)
    j -= goal - coordinate[j - 1] < coordinate[j] - goal
    i = np.arange(n)
    near = (np.abs(coordinate[j] - goal) <= tolerance) & (j > i)
    return i[near], j[near]


def rpe(p_est: Array, q_est: Array, p_true: Array, q_true: Array, pairs: tuple[Indices, Indices]) -> tuple[Stats, Stats]:
    """Relative pose error over pairs (i, j): translation [m] and rotation angle [rad].

    E_ij = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j),  Q true and P estimated poses                      (Sturm et al. 2012, eq. 1)
    """
    i, j = pairs
    if not len(i):
        return stats(np.empty(0)), stats(np.empty(0))
    r_est, r_true = rotation(q_est), rotation(q_true)
    step_est = r_est[i].inv().apply(p_est[j] - p_est[i])
    step_true = r_true[i].inv().apply(p_true[j] - p_true[i])
    turn = (r_true[i].inv() * r_true[j]).inv() * (r_est[i].inv() * r_est[j])
    return stats(step_est - step_true), stats(np.atleast_1d(turn.magnitude()))


class Drift(msgspec.Struct, frozen=True):
    """Position error in a span [m]; end_percent: of the distance."""

    rmse_m: float
    max_m: float
    end_m: float
    distance_m: float
    end_percent: float


def drift(p_error: Array, p_true: Array) -> Drift:
    """Drift of a span; end_percent = 100 |e_end| / distance, nan at a standstill."""
    s = stats(p_error)
    end = float(np.linalg.norm(p_error[-1])) if s.n else np.nan
    distance = float(path_length(p_true)[-1]) if s.n else 0.0
    return Drift(s.rmse, s.max, end, distance, 100.0 * end / distance if distance > 0.0 else np.nan)


def nees(error: Array, covariance: Array) -> Array:
    """e' P^-1 e, (n,); inf unless P is positive definite (Bar-Shalom et al. 2001, eq. 5.4.2-2)."""
    values = np.full(len(error), np.inf)
    sound = np.isfinite(covariance).all(axis=(1, 2)) & np.isfinite(error).all(axis=1)
    sound = np.asarray(sound & np.isclose(covariance, covariance.mT, rtol=1e-6, atol=1e-12).all(axis=(1, 2)))
    sound[sound] = _definite(covariance[sound])
    e, p = error[sound], covariance[sound]
    values[sound] = np.einsum("ni,ni->n", e, np.linalg.solve(p, e[..., None])[..., 0])
    return values


def _definite(covariance: Array) -> Mask:
    """Which of (n, k, k) symmetric matrices are positive definite, (n,)."""
    try:
        np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.eigvalsh(covariance)[:, 0] > 0.0)
    return np.ones(len(covariance), bool)


def chi2_band(dof: float, probability: float = 0.95) -> tuple[float, float]:
    """Two-sided chi-square interval of dof with the given probability."""
    tail = 0.5 * (1.0 - probability)
    return chi_square(tail, dof), chi_square(1.0 - tail, dof)


def effective_samples(x: Array) -> float:
    """n_eff = n / (1 + 2 sum_k rho_k), 1..n.

    rho_k: autocorrelation, summed until a pair rho_2m + rho_2m+1 is not positive (Geyer 1992, section 3.3).
    """
    n = len(x)
    if n < 4 or not np.isfinite(x).all():
        return float(n)
    centred = x - x.mean()
    power = float(centred @ centred)
    if not 0.0 < power < np.inf:
        return float(n)
    spectrum = np.fft.rfft(centred, 2 * n)
    rho = np.fft.irfft(np.abs(spectrum) ** 2)[:n] / power
    pairs = rho[0 : n - n % 2 : 2] + rho[1::2]
    last = int(np.argmax(pairs <= 0.0)) if (pairs <= 0.0).any() else len(pairs)
    return float(np.clip(n / (2.0 * pairs[:last].sum() - 1.0), 1.0, n)) if last else float(n)


class Consistency(msgspec.Struct, frozen=True):
    """Consistency of a covariance; mean = NEES / dof.

    band: 95 % of the mean; inside: share within the sample's interval; covered: within the 95 % ellipsoid.
    """

    dof: int
    n: int
    mean: float
    n_effective: float
    band: tuple[float, float]
    inside: float
    covered: float

    @property
    def consistent(self) -> bool:
        """Whether the mean lies in its band."""
        return self.band[0] <= self.mean <= self.band[1]


def consistency(values: Array, dof: int, n_effective: float | None = None) -> Consistency:
    """Judge (n,) NEES or NIS values of dof degrees of freedom.

        n_eff * mean(NEES) ~ chi2(n_eff * dof)                               (Bar-Shalom et al. 2001, eq. 5.4.2-8)

    n_effective: None: effective_samples(values), approximate for one flight.
    """
    n = len(values)
    if not n:
        return Consistency(dof, 0, np.nan, 0.0, (np.nan, np.nan), np.nan, np.nan)
    n_eff = effective_samples(values) if n_effective is None else float(n_effective)
    low, high = chi2_band(n_eff * dof)
    sample_low, sample_high = chi2_band(dof)
    return Consistency(
        dof=dof,
        n=n,
        mean=float(values.mean()) / dof,
        n_effective=n_eff,
        band=(low / (n_eff * dof), high / (n_eff * dof)),
        inside=float(np.mean((values >= sample_low) & (values <= sample_high))),
        covered=float(np.mean(values <= chi_square(0.95, dof))),
    )


def nis(innovation: Array, sigma: Array) -> Array:
    """sum_i (nu_i / s_i)^2, (n,) from (n, k): diagonal S (Bar-Shalom et al. 2001, eq. 5.4.2-9)."""
    total: Array = ((innovation / sigma) ** 2).sum(axis=1)
    return total


def waits(valid_ns: Times, arrived_ns: Times) -> Times:
    """(m, 2): validity of the newest information to arrival of newer; (n,) in any order."""
    pairs = []
    newest: int | None = None
    for k in np.lexsort((valid_ns, arrived_ns)):
        valid = int(valid_ns[k])
        if newest is None or valid > newest:
            if newest is not None:
                pairs.append((newest, int(arrived_ns[k])))
            newest = valid
    return np.array(pairs, np.int64).reshape(-1, 2)


def gaps(valid_ns: Times, arrived_ns: Times, end_ns: int, longer_than_ns: int) -> list[tuple[int, int]]:
    """Waits up to end_ns, each without what the one before covers, longer than longer_than_ns."""
    if not len(valid_ns):
        return []
    last = (int(valid_ns.max()), end_ns)
    spans: list[tuple[int, int]] = []
    for start, arrived in [*map(tuple, waits(valid_ns, arrived_ns).tolist()), last]:
        begin, end = max(start, spans[-1][1]) if spans else start, min(arrived, end_ns)
        if end - begin > longer_than_ns:
            spans.append((begin, end))
    return spans


def common(first: list[tuple[int, int]], second: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Intersection of two ordered sets of spans."""
    pairs = ((max(a, c), min(b, d)) for a, b in first for c, d in second)
    return [(start, end) for start, end in pairs if start < end]


def within(t_ns: Times, spans: list[tuple[int, int]]) -> Mask:
    """Stamps strictly inside a span, (n,) bool."""
    mask = np.zeros(len(t_ns), bool)
    for start, end in spans:
        mask |= (t_ns > start) & (t_ns < end)
    return mask
