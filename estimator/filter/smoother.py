"""Fixed-interval smoothing of a flight: forward through the tracker, then backward (docs/estimator.md, section 9).

    C_k   = P_k|k Phi_k^T P_k+1|k^-1
    x_k|N = x_k|k (+) C_k (x_k+1|N (-) x_k+1|k)
    P_k|N = P_k|k + C_k (P_k+1|N - P_k+1|k) C_k^T                                      (Rauch, Tung, Striebel 1965)

Segments end at the alignment, at IMU gaps, at doubts. The gain omits considered errors: the covariance may be too small while
fixes share one.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from estimator.filter.alignment import FilterConfig, TrackerConfig
from estimator.filter.hypotheses import Hypothesis
from estimator.filter.imu_buffer import ImuBuffer
from estimator.filter.tracker import Tracker
from estimator.sources.aids import aid_of
from estimator.sources.base.aid import Aid
from estimator.sources.imu.plausibility import sample_refusal
from estimator.sources.odometry import OdometryAid
from models import imu, so3
from models.frames import Origin
from models.messages import Array, ImuSample, Input
from models.state import E, X, carried, local, retract

_SPACING_NS = 100_000_000  # between nodes where there is no aid
_FUTURE_NS = 1_000_000_000  # a stamp further ahead of its stream's clock is a broken one


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """n nodes: aids, and every 0.1 s.

    nav (n, 16): packed NavState; covariance (n, 15, 15); gyro_b (n, 3) without bias, rad/s; segment (n,); place: lat_deg,
    lon_deg, alt_m of the origin.
    """

    t_ns: NDArray[np.int64]
    nav: Array
    covariance: Array
    gyro_b: Array
    segment: NDArray[np.int64]
    place: tuple[float, float, float] | None


@dataclass(frozen=True, slots=True, eq=False)
class Node:
    """One hypothesis at one instant, aids fused: x (16,), cov (15, 15); link None: a segment begins.

    late_cov: (3, 3) of the position by a delay or a step of a receiver's speed, not smoothed.
    """

    t_ns: int
    x: Array
    cov: Array
    link: "Link | None" = None
    late_cov: Array = field(default_factory=lambda: np.zeros((3, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """From the node before: Phi (15, 15), prediction."""

    before: Node
    phi: Array
    x: Array
    cov: Array


def smooth(messages: Iterable[Input], config: FilterConfig, progress: Callable[[float], None] | None = None) -> Smoothed:
    """Smooth a flight; messages in order of arrival; progress gets the fraction done."""
    samples, aids = sort(messages, config)
    tracker = Tracker(
        TrackerConfig(imu=config.imu, coast=config.coast, initialise=config.initialise, origin=Origin.of(config.origin))
    )
    leaders = []
    for fraction, leader in _forward(tracker, samples, aids):
        leaders.append(leader)
        if progress:
            progress(fraction)
    segments = list(_segments([leader for leader in leaders if leader is not None]))
    nodes = [node for segment in segments for node in segment]
    nav, covariance = np.zeros((len(nodes), X.SIZE)), np.zeros((len(nodes), E.SIZE, E.SIZE))
    begin = 0
    for segment in segments:
        end = begin + len(segment)
        nav[begin:end], covariance[begin:end] = backward(segment)
        covariance[begin:end, E.P, E.P] += [node.late_cov for node in segment]
        begin = end
    t_ns = np.array([node.t_ns for node in nodes], np.int64)
    number = np.repeat(np.arange(len(segments)), [len(segment) for segment in segments])
    return Smoothed(t_ns, nav, covariance, _rates(samples, t_ns) - nav[:, X.BG], number, tracker.place)


def backward(nodes: Sequence[Node]) -> tuple[Array, Array]:
    """Smoothed states (n, 16) and covariances (n, 15, 15) of one segment."""
    nav, covariance = np.array([node.x for node in nodes]), np.array([node.cov for node in nodes])
    for k in range(len(nodes) - 2, -1, -1):
        link = nodes[k + 1].link
        assert link is not None
        gain = covariance[k] @ link.phi.T @ _inverse(link.cov)
        off = local(link.x, nav[k + 1])
        later = carried(covariance[k + 1], so3.right_jacobian_inverse(off[E.THETA]))  # about the predicted state
        dx = gain @ off
        cov = covariance[k] + gain @ (later - link.cov) @ gain.T
        nav[k] = retract(nodes[k].x, dx)
        jacobian: Array = np.linalg.inv(so3.right_jacobian_inverse(dx[E.THETA])).astype(np.float64)
        cov = carried(cov, jacobian)
        covariance[k] = 0.5 * (cov + cov.T)
    return nav, covariance


def sort(messages: Iterable[Input], config: FilterConfig) -> tuple[ImuBuffer, list[Aid]]:
    """IMU samples, and aids by validity, once."""
    samples, aids = ImuBuffer(), dict[tuple[int, str, str, bytes], Aid]()
    newest_ns = arrived_ns = None
    for message in messages:
        if newest_ns is not None and arrived_ns is not None:
            ahead_ns = message.t_ns - newest_ns - max(0, message.arrived_ns - arrived_ns)
            if ahead_ns > _FUTURE_NS:
                continue
        if isinstance(message, ImuSample):
            if sample_refusal(message) is None:
                samples.insert(message)
                newest_ns, arrived_ns = samples.newest_ns, message.arrived_ns
        elif isinstance(aid := aid_of(message, config), Aid) and not isinstance(aid, OdometryAid):  # it links two nodes
            aids.setdefault(aid.order, aid)
    return samples, [aids[order] for order in sorted(aids)]


def _forward(tracker: Tracker, samples: ImuBuffer, aids: list[Aid]) -> Iterator[tuple[float, Node | None]]:
    if not samples.count:
        return
    at = {t_ns: list(group) for t_ns, group in groupby(aids, key=lambda aid: aid.t_ns)}
    stamps = samples.t_ns[: samples.count]
    first_in_period = np.flatnonzero(np.diff(stamps // _SPACING_NS, prepend=-1))
    stops = sorted({*stamps[first_in_period].tolist(), samples.newest_ns, *(t for t in at if t <= samples.newest_ns)})
    tips: dict[Hypothesis, Node] = {}
    for k, t_ns in enumerate(stops):
        tips = _step(tracker, samples, tips, t_ns, at.get(t_ns, []))
        leader = tips[tracker.core.hypotheses.members[0]] if tracker.core.hypotheses is not None and tips else None
        yield (k + 1) / len(stops), leader


def _step(
    tracker: Tracker, samples: ImuBuffer, tips: dict[Hypothesis, Node], t_ns: int, aids: list[Aid]
) -> dict[Hypothesis, Node]:
    index, from_ns = samples.first_after(tracker.core.t_ns), tracker.core.t_ns
    missing = _imu_missing(samples, from_ns, t_ns, tracker.core.config.coast.gap_s)
    phis = {} if missing else {m: _transition(m, samples, index, t_ns) for m in tips}
    tracker.propagate(samples, t_ns)
    links = {m: Link(tips[m], phi, m.filter.x.copy(), m.filter.cov[: E.SIZE, : E.SIZE].copy()) for m, phi in phis.items()}
    for aid in aids:
        state_before = {m.filter.x.tobytes(): m for m in links}
        tracker.process(aid, samples)
        if tracker.core.hypotheses is not None:
            links |= _of_parents(tracker.core.hypotheses.members, links, state_before)
    if tracker.core.hypotheses is None or not tracker.core.is_aligned:
        return {}
    members = tracker.core.hypotheses.members
    late = np.zeros((3, 3)) if tracker.late_cov is None else tracker.late_cov
    if (stepped := tracker.step_covariance) is not None:
        late = late + stepped[E.P, E.P]
    return {m: Node(t_ns, m.filter.x.copy(), m.filter.cov[: E.SIZE, : E.SIZE].copy(), links.get(m), late) for m in members}


def _of_parents(
    members: list[Hypothesis], links: dict[Hypothesis, Link], state_before: dict[bytes, Hypothesis]
) -> dict[Hypothesis, Link]:
    born = {m: state_before.get(m.filter.x.tobytes()) for m in members if m not in links}
    return {m: links[parent] for m, parent in born.items() if parent is not None}


def _segments(leaders: list[Node]) -> Iterator[list[Node]]:
    segments: list[list[Node]] = []
    left = len(leaders)
    while left:
        node = leaders[left - 1]
        segment = [node]
        while node.link is not None:
            node = node.link.before
            segment.append(node)
        segments.append(segment[::-1])
        left -= len(segment)
    yield from reversed(segments)


def _transition(member: Hypothesis, samples: ImuBuffer, index: int, to_ns: int) -> Array:
    f = member.filter
    return imu.transition(f.x, samples.t_ns, samples.u, samples.count, index, f.t_ns, to_ns, f.constants)


def _imu_missing(samples: ImuBuffer, from_ns: int, to_ns: int, gap_s: float) -> bool:
    begin, end = samples.first_after(from_ns) - 1, samples.first_after(to_ns - 1)
    if begin < 0 or end >= samples.count:
        return True
    return bool(np.diff(samples.t_ns[begin : end + 1]).max(initial=0) * 1e-9 > gap_s)


def _rates(samples: ImuBuffer, t_ns: NDArray[np.int64]) -> Array:
    n, gyro = samples.count, slice(0, 3)
    at = [imu.interpolate(samples.t_ns, samples.u, n, samples.first_after(t), t)[gyro] for t in t_ns.tolist()]
    return np.array(at).reshape(-1, 3)


def _inverse(cov: Array) -> Array:
    """P^-1 by way of correlations: units differ by many powers of ten."""
    sigma = np.sqrt(np.diag(cov))
    scale = np.outer(sigma, sigma)
    inverse: Array = np.linalg.pinv(cov / scale, hermitian=True) / scale
    return inverse
