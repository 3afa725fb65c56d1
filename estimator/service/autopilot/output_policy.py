"""What an autopilot is sent, and when: "odometry" all the time, a "fix" only when something new to it entered.

The autopilot has an IMU and, often, the GNSS receiver that we listen to as well. Sent an estimate that rests on these alone, it
would count them twice. So a fix goes out only when a landmark or another fix from outside was fused while its own GNSS was not,
and the quality of the odometry says what it rests on:

    100         a fix from outside was fused within dead_reckoning_after_s
    99 ... 1    dead reckoning since then: 100 * 2^(-age / 10 s)
      0         nothing but the autopilot's own GNSS and IMU
     -1         no IMU, or not aligned: do not use
"""

from collections.abc import Iterable, Sequence
from typing import Annotated, Final, Literal

import msgspec
import numpy as np
from msgspec import Meta

from models.messages import AidStatus, Estimate, Mode, Output, Reason
from models.state import X

_HALVING_S: Final = 10.0
_GNSS_KINDS: Final = frozenset({"gnss_position", "gnss_velocity"})
_NEVER: Final = -(2**62)
_SECOND_NS: Final = 1_000_000_000
_LARGEST: Final = 1e12  # of any number of an estimate that is one, in SI units and their squares
_LAT_DEG, _LON_DEG, _HEIGHT_M = 90.0, 360.0, 1e5


class AutopilotConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[autopilot]: its own sensors, and the output that it is sent."""

    own_gnss: Annotated[bool, Meta(description="whether the GNSS that we fuse is the autopilot's own receiver")] = True
    gnss_quiet_s: Annotated[
        float, Meta(ge=0, le=1e6, description="s: its own GNSS must not have been fused for so long before a fix goes out")
    ] = 5.0
    odometry_hz: Annotated[
        float, Meta(ge=0.01, le=50, description="Hz: rate of the odometry; PX4 needs more than 5, ArduPilot 4 to 50")
    ] = 30.0


class Px4Config(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[px4]: PX4's zenoh module; its ZENOH_DOMAIN_ID is [zenoh] domain."""

    enabled: Annotated[bool, Meta(description="whether the estimate is sent to PX4")] = False
    odometry: Annotated[bool, Meta(description="vehicle_visual_odometry, for EKF2_EV_CTRL")] = True
    fixes: Annotated[bool, Meta(description="aux_global_position, for EKF2_AGPx")] = True
    release: Annotated[Literal["1.17", "1.18"], Meta(description="of PX4; 1.17 stands for 1.16 too, 1.18 for what is newer")] = (
        "1.18"
    )
    slot: Annotated[int, Meta(ge=1, le=255, description="EKF2_AGPx_ID of the slot that the fixes are for")] = 1


class Handover:
    """Listens to everything the estimator says; answers for the estimate at hand."""

    def __init__(self, config: AutopilotConfig, fixed_for_s: float) -> None:
        """fixed_for_s: [estimator] dead_reckoning_after_s."""
        self._own_gnss, self._fixed_for_s = config.own_gnss, fixed_for_s
        self._quiet_ns = round(config.gnss_quiet_s * _SECOND_NS)
        self._gnss_ns = self._outside_ns = _NEVER

    def note(self, outputs: Iterable[Output]) -> bool:
        """Take notice; whether a fix from outside is among what was just fused."""
        news = False
        for output in outputs:
            if not isinstance(output, AidStatus) or output.reason is not Reason.FUSED:
                continue
            if output.kind in _GNSS_KINDS and self._own_gnss:
                self._gnss_ns = max(self._gnss_ns, output.t_ns)
            elif output.kind in {"pose", "gnss_position"}:
                self._outside_ns = max(self._outside_ns, output.t_ns)
                news = True
        return news

    def is_fix(self, estimate: Estimate) -> bool:
        """Whether the estimate, into which a fix has just entered, may be sent as one."""
        return estimate.mode is Mode.AIDED and estimate.t_ns - self._gnss_ns > self._quiet_ns

    def quality(self, estimate: Estimate) -> int:
        """-1 to 100, as above."""
        if estimate.mode not in {Mode.AIDED, Mode.DEAD_RECKONING}:
            return -1
        if self._outside_ns == _NEVER or estimate.t_ns - self._gnss_ns <= self._quiet_ns or self._gnss_ns > self._outside_ns:
            return 0
        age_s = (estimate.t_ns - self._outside_ns) / _SECOND_NS
        return 100 if age_s <= self._fixed_for_s else max(1, min(99, round(100 * 2 ** (-age_s / _HALVING_S))))


def newest(outputs: Sequence[Output]) -> Estimate | None:
    """The estimate among the outputs of one input, if there is one; none without a heading, which no message can leave out."""
    known = (o for o in reversed(outputs) if isinstance(o, Estimate) and o.mode is not Mode.ALIGNING_HEADING)
    return next(known, None)


def is_sound(e: Estimate) -> bool:
    """Whether messages can be made of it: numbers of possible size, no negative variance, a rotation, an origin on Earth."""
    lat, lon, alt = e.origin or (0.0, 0.0, 0.0)
    return bool(
        all(np.abs(numbers).max() <= _LARGEST for numbers in (e.nav, e.covariance, e.gyro_b))
        and np.diagonal(e.covariance).min() >= 0.0
        and 0.5 <= np.linalg.norm(e.nav[X.Q]) <= 2.0
        and abs(lat) <= _LAT_DEG
        and abs(lon) <= _LON_DEG
        and abs(alt) <= _HEIGHT_M
    )
