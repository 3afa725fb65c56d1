"""Pairs for visual odometry, and the predicted motion between them.

    pairs -> KeyFrames -> OdometryRequest (with the motion of Track) -> odometry.OdometryProcessor -> OdometryDelta or a report

Increments never overlap.
"""

from typing import Annotated, Final, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta

from estimator.frontend.requests import Pair, Shot, Track
from models import so3
from models.messages import ImageName, OdometryRequest, vec3
from models.state import E, X

_VELOCITY_SIGMA, _RATE_SIGMA = 0.05, 0.002  # m/s and rad/s: what the prediction is uncertain by at least
_TURN_SIGMA: Final = 0.001  # rad

_Height: TypeAlias = Annotated[float, Meta(ge=-1e4, le=1e4)]


class VisualOdometryConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[visual_odometry]: the cameras of [rig] measure the motion between pairs."""

    enabled: Annotated[bool, Meta(description="whether the motion between pairs is measured and fused as odometry")] = False
    interval_s: Annotated[float, Meta(ge=0.02, le=10, description="s: from one key frame to the next")] = 0.5
    longest_s: Annotated[float, Meta(ge=0.02, le=10, description="s: pairs further apart than this are not compared")] = 1.5
    ground_m: Annotated[
        _Height | None, Meta(description="m: height of the ground above the map's origin, where it is level; not given: not used")
    ] = None
    ground_sigma_m: Annotated[float, Meta(ge=0.01, le=1000, description="m: 1-sigma of that height around the vehicle")] = 2.0

    @property
    def level(self) -> tuple[float, float] | None:
        """Level ground above the map's origin, and 1-sigma, m; None: unknown."""
        return None if self.ground_m is None else (self.ground_m, self.ground_sigma_m)


class KeyFrames:
    """Chooses pairs and requests them, one at a time."""

    def __init__(self, config: VisualOdometryConfig) -> None:
        self._config = config
        self._interval_ns, self._longest_ns = round(config.interval_s * 0.95e9), round(config.longest_s * 1e9)
        self._key: Pair | None = None

    def request(self, pair: Pair, track: Track, arrived_ns: int) -> tuple[OdometryRequest, Pair] | None:
        """The request and its earlier pair; None: not due, or no prediction."""
        key = self._key
        if key is not None and 0 <= pair.t_ns - key.t_ns < self._interval_ns:
            return None
        self._key = pair
        if key is None or not self._interval_ns <= pair.t_ns - key.t_ns <= self._longest_ns:
            return None
        request = self._predicted(key, pair, track, arrived_ns)
        return None if request is None else (request, key)

    def _predicted(self, first: Pair, second: Pair, track: Track, arrived_ns: int) -> OdometryRequest | None:
        """dp_b = R_0^T int v dt, dq = prod exp(w dt)."""
        t0_ns, t1_ns = first.t_ns, second.t_ns
        estimates = track.between(t0_ns, t1_ns)
        if not estimates:
            return None
        begin = estimates[0]
        q0 = so3.normalise(so3.multiply(begin.nav[X.Q], so3.quat_exp(np.array(begin.gyro_b) * ((t0_ns - begin.t_ns) * 1e-9))))
        R_0 = so3.matrix(q0)
        dp_n, dq = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
        times = [t0_ns, *(e.t_ns for e in estimates[1:] if e.t_ns < t1_ns), t1_ns]
        for e, a_ns, b_ns in zip(estimates, times, times[1:], strict=False):
            dt = (b_ns - a_ns) * 1e-9
            dp_n += e.nav[X.V] * dt
            dq = so3.multiply(dq, so3.quat_exp(np.array(e.gyro_b) * dt))
        dt = (t1_ns - t0_ns) * 1e-9
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = (R_0.T @ begin.covariance[E.V, E.V] @ R_0 + np.eye(3) * _VELOCITY_SIGMA**2) * dt**2
        turn = begin.covariance[E.BG, E.BG] + np.eye(3) * _RATE_SIGMA**2
        covariance[3:, 3:] = turn * dt**2 + np.eye(3) * _TURN_SIGMA**2
        height, sigma = self._height(float(begin.nav[X.P][2]), float(begin.covariance[E.P, E.P][2, 2]))
        w, x, y, z = so3.normalise(dq).tolist()
        return OdometryRequest(
            t_ns=t1_ns,
            arrived_ns=arrived_ns,
            t0_ns=t0_ns,
            dp_b=vec3(R_0.T @ dp_n),
            dq_wxyz=(w, x, y, z),
            covariance=0.5 * (covariance + covariance.T),
            first=(name_of(first.left), name_of(first.right)),
            second=(name_of(second.left), name_of(second.right)),
            down_b=vec3(R_0[2]),
            height_m=height,
            height_sigma_m=sigma,
        )

    def _height(self, down_m: float, variance: float) -> tuple[float, float]:
        if self._config.ground_m is None:
            return 0.0, 0.0
        height = -down_m - self._config.ground_m
        return (height, float(np.hypot(np.sqrt(variance), self._config.ground_sigma_m))) if height > 0.0 else (0.0, 0.0)


def name_of(shot: Shot | None) -> ImageName | None:
    """An image's name in a request."""
    return shot.name if shot else None
