"""Images to requests: pairs, with the estimate at exposure as prior.

    images -> Pairing -> VisionRequest (with the prior of Track) -> processor.Processor -> LandmarkFix, VisionReport

Requests are logged.
"""

from collections import deque
from collections.abc import Iterable
from typing import Annotated, Final, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from models import so3
from models.messages import Array, Estimate, ImageName, Mode, Output, VisionRequest, vec3
from models.state import E, X

_SECOND_NS: Final = 1_000_000_000
_OLDEST_NS: Final = 200_000_000  # an estimate further from the exposure is not used for it
_KEPT: Final = 2000  # estimates: seconds at IMU rate


class VisionConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[vision]: used with [rig] file and [map] landmarks."""

    most_hz: Annotated[float, Meta(ge=0.01, le=100, description="Hz: at most so many pairs are processed")] = 10.0
    pair_ms: Annotated[float, Meta(ge=0, le=100, description="ms: stamps of a pair differ by no more")] = 5.0
    patience_ms: Annotated[
        float, Meta(ge=0, le=1000, description="ms: how long one image waits for the other, then it goes alone")
    ] = 100.0
    timeout_s: Annotated[
        float, Meta(ge=0.01, le=3600, description="s: vision or odometry that does not answer for so long is started anew")
    ] = 2.0


class Shot(NamedTuple):
    """An image as received; t_ns: exposure, on the estimates' clock."""

    topic: str
    schema: str
    data: bytes
    stamp_ns: int
    t_ns: int
    arrived_ns: int

    @property
    def name(self) -> ImageName:
        """Its name in a request."""
        return ImageName(self.topic, self.stamp_ns)


class Pair(NamedTuple):
    """Images taken at once, or one alone."""

    left: Shot | None
    right: Shot | None

    @property
    def t_ns(self) -> int:
        """Exposure of the left image, or of the only one."""
        shot = self.left or self.right
        assert shot is not None
        return shot.t_ns


class Pairing:
    """Pairs images by stamps, at most most_hz; unpaired ones go alone, at once where `alone`."""

    def __init__(self, config: VisionConfig, alone: bool = False) -> None:
        self._alone = alone
        self._pair_ns, self._patience_ns = round(config.pair_ms * 1e6), round(config.patience_ms * 1e6)
        self._period_ns = round(_SECOND_NS / config.most_hz * 0.9)  # images at that very rate all go on
        self._waiting: dict[str, deque[Shot]] = {"left": deque(maxlen=8), "right": deque(maxlen=8)}
        self._last_ns = 0

    def put(self, side: str, shot: Shot) -> list[Pair]:
        """Add a "left" or "right" image; pairs now complete."""
        if self._alone:
            return self._paced(Pair(shot, None) if side == "left" else Pair(None, shot))
        other_side = "right" if side == "left" else "left"
        ready = self.overdue(shot.arrived_ns)
        others = self._waiting[other_side]
        other = min(others, key=lambda o: abs(o.t_ns - shot.t_ns), default=None)
        if other is None or abs(other.t_ns - shot.t_ns) > self._pair_ns:
            self._waiting[side].append(shot)
            return ready
        while others and others.popleft() is not other:
            pass
        self._waiting[side].clear()
        pair = Pair(shot, other) if side == "left" else Pair(other, shot)
        return [*ready, *self._paced(pair)]

    def overdue(self, now_ns: int) -> list[Pair]:
        """Images whose partner is overdue."""
        alone: list[Pair] = []
        for side, shots in self._waiting.items():
            while shots and now_ns - shots[0].arrived_ns > self._patience_ns:
                shot = shots.popleft()
                alone += self._paced(Pair(shot, None) if side == "left" else Pair(None, shot))
        return alone

    def _paced(self, pair: Pair) -> list[Pair]:
        if 0 <= pair.t_ns - self._last_ns < self._period_ns or -_SECOND_NS < pair.t_ns - self._last_ns < 0:
            return []
        self._last_ns = pair.t_ns
        return [pair]


class Track:
    """Estimates of the last seconds; thread-safe."""

    def __init__(self) -> None:
        self._estimates: deque[Estimate] = deque(maxlen=_KEPT)

    def note(self, outputs: Iterable[Output]) -> None:
        """Keep Fusion's estimates; without a heading they are no prior."""
        self._estimates.extend(o for o in outputs if isinstance(o, Estimate) and o.mode is not Mode.ALIGNING_HEADING)

    @property
    def mode(self) -> str:
        """Mode of the newest estimate; "" before the first."""
        return self._estimates[-1].mode if self._estimates else ""

    def between(self, t0_ns: int, t1_ns: int) -> list[Estimate]:
        """Estimates in and next to the interval; [] where an end is not covered."""
        kept = sorted((e for e in tuple(self._estimates)), key=lambda e: e.t_ns)
        inside = [e for e in kept if t0_ns < e.t_ns < t1_ns]
        before, after = [e for e in kept if e.t_ns <= t0_ns], [e for e in kept if e.t_ns >= t1_ns]
        chosen = [*before[-1:], *inside, *after[:1]]
        covered = chosen and chosen[0].t_ns - t0_ns <= _OLDEST_NS and t1_ns - chosen[-1].t_ns <= _OLDEST_NS
        return chosen if covered else []

    def request(self, pair: Pair, arrived_ns: int, run: int = 0) -> VisionRequest | None:
        """Pose at exposure as prior; None if unknown."""
        t_ns = pair.t_ns
        near = min(tuple(self._estimates), key=lambda e: abs(e.t_ns - t_ns), default=None)
        if near is None or abs(near.t_ns - t_ns) > _OLDEST_NS:
            return None
        p_n, q, covariance = prior_at(near, t_ns)
        w, x, y, z = q.tolist()
        left, right = (shot.name if shot else None for shot in pair)
        return VisionRequest(t_ns, arrived_ns, vec3(p_n), (w, x, y, z), covariance, left, right, run)


def prior_at(estimate: Estimate, t_ns: int) -> tuple[Array, Array, Array]:
    """p + v dt, R exp(w dt), and covariance (6, 6) about the axes of n: J P J^T, J = diag(I, R)."""
    dt = (t_ns - estimate.t_ns) * 1e-9
    x, cov = estimate.nav, estimate.covariance
    q = so3.normalise(so3.multiply(x[X.Q], so3.quat_exp(np.array(estimate.gyro_b) * dt)))
    pose = np.r_[E.P, E.THETA]
    jacobian = np.eye(6)
    jacobian[3:, 3:] = so3.matrix(x[X.Q])
    covariance = jacobian @ cov[np.ix_(pose, pose)] @ jacobian.T
    return x[X.P] + x[X.V] * dt, q, 0.5 * (covariance + covariance.T)
