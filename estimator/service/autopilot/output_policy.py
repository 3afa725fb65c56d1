"""Output: "odometry" continuously, a "fix" when a landmark or outside fix was fused, not the autopilot's GNSS.

Quality, r and r_v the 95 % radii of position and velocity, r_max = most_radius_m, v_max = 1 m/s:

    100 ... 1   100 (1 - r / r_max), or where r >= r_max 100 (1 - r_v / v_max) of the velocity alone (PX4)
      0         only the autopilot's own GNSS and IMU, by own_gnss_quality
     -1         both too large, no IMU, not aligned, or integrity "do not use"
"""

from collections.abc import Iterable, Sequence
from typing import Annotated, Final, Literal

import msgspec
import numpy as np
from msgspec import Meta

from models.messages import AidStatus, Alert, Estimate, Integrity, Mode, Output, Reason, Vec3
from models.radius import horizontal_radius
from models.state import E, X

_BYTE: Final = 256
_STEP_M, _STEP_SIGMAS = 1.0, 3.0  # a step is larger than both
_GAP_NS: Final = 1_000_000_000  # after a longer pause a step cannot be separated from the way flown, and is assumed
_GNSS_KINDS: Final = frozenset({"gnss_position", "gnss_velocity"})
_NEVER: Final = -(2**62)
_MOST_VELOCITY_M_S: Final = 1.0  # 95 % radius of usable velocity; PX4's COM_VEL_FS_EVH
_SECOND_NS: Final = 1_000_000_000
_LARGEST: Final = 1e12  # of any number of an estimate that is one, in SI units and their squares
_TINY: Final = 1e-9
_LAT_DEG, _LON_DEG, _HEIGHT_M = 90.0, 360.0, 1e5


class AutopilotConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[autopilot]: its own sensors, and our output to it."""

    own_gnss: Annotated[bool, Meta(description="whether the GNSS that we fuse is the autopilot's own receiver")] = True
    own_gnss_quality: Annotated[
        Literal["auto", "radius", "zero"],
        Meta(
            description="quality of odometry that rests on its own GNSS; zero: PX4, which fuses both at once; "
            "radius: ArduPilot, which takes one source at a time; auto: by autopilot"
        ),
    ] = "auto"
    most_radius_m: Annotated[
        float,
        Meta(
            ge=0.1,
            le=1e6,
            description="m: 95 % radius r from which on the position is not to be used; below quality 100 (1 - r / this)",
        ),
    ] = 15.0
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
    origin: Annotated[
        Literal["read", "map"],
        Meta(
            description="where odometry counts from while vehicle_local_position has no reference; read: quality -1 until it has "
            "one; map: PX4's local frame begins at our origin (no GNSS in PX4)"
        ),
    ] = "read"
    release: Annotated[Literal["1.17", "1.18"], Meta(description="of PX4; 1.17 also for 1.16, 1.18 also for newer ones")] = "1.18"
    slot: Annotated[int, Meta(ge=1, le=255, description="EKF2_AGPx_ID of the slot that the fixes are for")] = 1


class OutputPolicy:
    """Answers for the present estimate; one per link."""

    def __init__(self, config: AutopilotConfig) -> None:
        self._config = config
        self._quiet_ns = round(config.gnss_quiet_s * _SECOND_NS)
        self._gnss_ns = self._outside_ns = _NEVER
        self._steps = 0
        self._last: tuple[Estimate, Vec3] | None = None
        self._usable_ns = _NEVER  # of the last position sent that was to be used
        self.integrity: Integrity | None = None  # the newest, where alert limits are configured

    @property
    def most_radius_m(self) -> float:
        """95 % radius of usable odometry."""
        return self._config.most_radius_m

    def note(self, outputs: Iterable[Output]) -> bool:
        """Note outputs; whether an outside fix was just fused."""
        news = False
        for output in outputs:
            if isinstance(output, Integrity) and output.state is not Alert.NOT_JUDGED:
                self.integrity = output
            if not isinstance(output, AidStatus) or output.reason is not Reason.FUSED:
                continue
            if output.kind in _GNSS_KINDS and self._config.own_gnss:
                self._gnss_ns = max(self._gnss_ns, output.t_ns)
            elif output.kind in {"pose", "gnss_position"}:
                self._outside_ns = max(self._outside_ns, output.t_ns)
                news = True
        return news

    def is_fix(self, estimate: Estimate) -> bool:
        """Whether the estimate with a new fix may be sent as one."""
        return estimate.mode is Mode.AIDED and estimate.t_ns - self._gnss_ns > self._quiet_ns and not self.is_alarmed

    @property
    def starts_without_gnss(self) -> bool:
        """Whether outside fixes, and never the autopilot's own GNSS, have been fused."""
        return self._outside_ns != _NEVER and self._gnss_ns == _NEVER

    @property
    def is_alarmed(self) -> bool:
        """Whether integrity forbids the use of the estimate."""
        return self.integrity is not None and self.integrity.state is Alert.DO_NOT_USE

    def widened(self, estimate: Estimate) -> Estimate:
        """Sigmas of the protection levels where alert limits are set: P <- D P D, D = diag(s, s, v), s, v >= 1."""
        if self.integrity is None:
            return estimate
        P = estimate.covariance
        sigma_h, sigma_v = np.sqrt(np.linalg.eigvalsh(P[:2, :2])[-1]), np.sqrt(P[2, 2])
        scale = np.ones(len(P))
        scale[:2] = max(1.0, self.integrity.sigma_h_m / max(sigma_h, _TINY))
        scale[2] = max(1.0, self.integrity.sigma_v_m / max(sigma_v, _TINY))
        return msgspec.structs.replace(estimate, covariance=P * np.minimum(np.outer(scale, scale), _LARGEST))

    def quality(self, estimate: Estimate, *, one_source_at_a_time: bool) -> tuple[int, bool]:
        """-1 to 100, as above, and whether the position may be used; one_source_at_a_time: ArduPilot."""
        if estimate.mode not in {Mode.AIDED, Mode.ODOMETRY, Mode.DEAD_RECKONING} or self.is_alarmed:
            return -1, False
        share = _radius(estimate, E.P) / self._config.most_radius_m
        has_position = share < 1.0
        if not has_position and not one_source_at_a_time:
            share = _radius(estimate, E.V) / _MOST_VELOCITY_M_S
        if not share < 1.0:
            return -1, False
        without_ns = estimate.t_ns - self._gnss_ns  # increments since then are from outside
        rests_on_its_own = without_ns <= self._quiet_ns or (
            estimate.mode is not Mode.ODOMETRY and (self._outside_ns == _NEVER or self._gnss_ns > self._outside_ns)
        )
        policy = self._config.own_gnss_quality
        if rests_on_its_own and (policy == "zero" or (policy == "auto" and not one_source_at_a_time)):
            return 0, has_position
        return max(1, round(100.0 * (1.0 - share))), has_position

    def reset_counter(self, estimate: Estimate, p_n: Vec3, *, usable: bool) -> int:
        """0 to 255, for p_n [m] in the autopilot's frame.

        Increased for |p - (p' + (v + v') dt / 2)| > max(1 m, 3 sigma), a reset, or a second without a usable position.
        """
        last, usable_ns = self._last, self._usable_ns
        self._last = estimate, p_n
        self._usable_ns = estimate.t_ns if usable else usable_ns
        if last is not None:
            step = _has_stepped(*last, estimate, p_n)
            again = usable and estimate.t_ns - usable_ns > _GAP_NS
            self._steps += (step or again) and last[0].reset_counter == estimate.reset_counter
        return (estimate.reset_counter + self._steps) % _BYTE


def _radius(e: Estimate, part: slice) -> float:
    """Of the horizontal position [m] or velocity [m/s], 95 %."""
    return float(horizontal_radius(e.covariance[None, part, part][:, :2, :2])[0])


def _has_stepped(before: Estimate, p_before: Vec3, now: Estimate, p_n: Vec3) -> bool:
    dt_ns = now.t_ns - before.t_ns
    if not 0 < dt_ns <= _GAP_NS:
        return False
    way = 0.5 * (before.nav[X.V] + now.nav[X.V]) * (dt_ns / _SECOND_NS)
    off = np.hypot(*(np.subtract(p_n, p_before) - way)[:2])
    return bool(off > max(_STEP_M, _STEP_SIGMAS * np.sqrt(np.linalg.eigvalsh(now.covariance[E.P, E.P][:2, :2])[-1])))


def newest(outputs: Sequence[Output]) -> Estimate | None:
    """The newest estimate among outputs, None without a heading."""
    known = (o for o in reversed(outputs) if isinstance(o, Estimate) and o.mode is not Mode.ALIGNING_HEADING)
    return next(known, None)


def is_sound(e: Estimate) -> bool:
    """Whether messages can hold it."""
    lat, lon, alt = e.origin or (0.0, 0.0, 0.0)
    return bool(
        all(np.abs(numbers).max() <= _LARGEST for numbers in (e.nav, e.covariance, e.gyro_b))
        and np.diagonal(e.covariance).min() >= 0.0
        and 0.5 <= np.linalg.norm(e.nav[X.Q]) <= 2.0
        and abs(lat) <= _LAT_DEG
        and abs(lon) <= _LON_DEG
        and abs(alt) <= _HEIGHT_M
    )
