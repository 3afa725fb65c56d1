"""PX4's zenoh module as an Outbox.

Stamps are PX4's, from fmu/out/...; quality -1 until EKF2's origin is known.
"""

import struct
from collections.abc import Sequence
from typing import Any, Final

import zenoh
from msgspec.structs import replace

from estimator.publish import Pace
from estimator.service.autopilot import px4_messages as px4
from estimator.service.autopilot.clock import AutopilotClock
from estimator.service.autopilot.local_frame import LocalOrigin
from estimator.service.autopilot.output_policy import OutputPolicy, Px4Config, is_sound, newest
from estimator.service.base.clock import SECOND_NS, Clock
from estimator.service.base.ports import Inbox
from estimator.service.zenoh.keys import rmw_key
from logs.wire.codec import Encoded, Topics
from models import so3
from models.frames import Origin
from models.messages import Array, Estimate, Output, Reading, Vec3, vec3
from models.state import X

_TIMESTAMP: Final = struct.Struct("<4xQ")  # behind the encapsulation every message of PX4 begins with it, us
_SENT: Final = struct.Struct("<8xQ17x")  # of the attachment, us
_US: Final = 1_000
GNSS_TOPIC: Final = "/fmu/out/vehicle_gps_position"  # in [inputs] gnss; with /velocity behind it in gnss_velocity
_LANDED: Final = "/fmu/out/vehicle_land_detected/"
_STALE_NS: Final = 60 * SECOND_NS
_REFERENCE_NS: Final = 3 * SECOND_NS  # without a local position its reference may be another one


class Px4Link:
    """An Outbox on the bus's session."""

    def __init__(
        self,
        config: Px4Config,
        session: zenoh.Session,
        domain: int,
        clock: Clock,
        policy: OutputPolicy,
        odometry_hz: float,
        geoid_m: float,
    ) -> None:
        self._config, self._clock, self._policy, self._geoid_m = config, clock, policy, geoid_m
        self._pace = Pace(odometry_hz)
        self._boot, self._heard_ns = AutopilotClock(), 0
        self._local, self._reference_ns = LocalOrigin(), 0
        self._feed: tuple[Inbox, bool, bool] | None = None  # whether it takes positions and velocities
        self._landed: tuple[Inbox, str] | None = None  # the topic
        self._has_none = True  # as far as it has said since its boot; silence later on is no such word
        self._map_origin: Vec3 | None = None
        self._quality: int | None = None  # of the last odometry
        self._fix_waits, self._reception = False, ""
        self.sent_odometry = self.sent_fixes = self.unsent = self.out_of_range = self.implausible_references = 0
        fix_type = px4.AUX_GLOBAL_POSITION if config.release == "1.18" else px4.VEHICLE_GLOBAL_POSITION
        drop: Any = {"congestion_control": zenoh.CongestionControl.DROP, "express": True}
        keys = {
            topic: rmw_key(domain, f"fmu/in/{topic}", schema, px4.type_hash(schema))
            for topic, schema in (("vehicle_visual_odometry", px4.VEHICLE_ODOMETRY), ("aux_global_position", fix_type))
        }
        self._odometry, self._fix = (session.declare_publisher(key, **drop) for key in keys.values())
        self._local_key = rmw_key(
            domain, "fmu/out/vehicle_local_position", px4.VEHICLE_LOCAL_POSITION, px4.type_hash(px4.VEHICLE_LOCAL_POSITION)
        )
        self._subscriber = session.declare_subscriber(f"{domain}/fmu/out/**", self._hear)

    def open_inputs(self, inbox: Inbox, topics: Topics) -> None:
        """Feed its GNSS receiver to those of the topics that are PX4's."""
        receivers = GNSS_TOPIC in topics.gnss, f"{GNSS_TOPIC}/velocity" in topics.gnss_velocity
        self._feed = (inbox, *receivers) if any(receivers) else None
        self._landed = (inbox, topics.rest[0]) if topics.rest else None

    def send(self, outputs: Sequence[Output], encoded: Sequence[Encoded]) -> None:  # noqa: ARG002  (an Outbox is given both)
        """Send the outputs meant for PX4."""
        self._fix_waits |= self._policy.note(outputs)
        estimate = newest(outputs)
        if estimate is None:
            return
        now_ns = self._clock.now_ns()
        offset = self._boot.offset
        sent_ns, sample_ns = offset.theirs(now_ns), offset.theirs(estimate.t_ns)
        if sent_ns is None or sample_ns is None or now_ns - self._heard_ns > _STALE_NS or sample_ns < 0:
            return
        if not is_sound(estimate):
            self.out_of_range += 1
            return
        try:
            if self._config.odometry and self._pace.due(estimate.t_ns):
                data = self._vehicle_odometry(estimate, now_ns, sent_ns // _US, sample_ns // _US)
                self.sent_odometry += self._put(self._odometry, data)
            if self._fix_waits:
                self._fix_waits = False
                self._tell_fix(estimate, sent_ns // _US, sample_ns // _US)
        except zenoh.ZError:
            self.unsent += 1

    def close(self) -> None:
        """The session is the bus's to close."""

    def report(self) -> dict[str, Any]:
        """For the status."""
        ahead_ns = self._boot.offset.ahead_ns
        return {
            "clock_ahead_s": "unknown" if ahead_ns is None else f"{ahead_ns * 1e-9:.6f}",
            "reboots": self._boot.reboots,
            "implausible_stamps": self._boot.implausible,
            "ekf_origin": self._local.report(self._map_origin, self._geoid_m, from_ours=self._from_ours),
            "implausible_references": self.implausible_references,
            "odometry": self.sent_odometry,
            "quality": "none sent" if self._quality is None else self._quality,
            "fixes": self.sent_fixes,
            "unsent": self.unsent,
            "out_of_range": self.out_of_range,
            "receiver": self._reception,
        }

    @property
    def _from_ours(self) -> bool:
        return self._config.origin == "map"

    def _vehicle_odometry(self, estimate: Estimate, now_ns: int, sent_us: int, sample_us: int) -> bytes | None:
        if now_ns - self._reference_ns > _REFERENCE_NS:
            self._local.forget()
        self._map_origin = estimate.origin
        ours: tuple[Vec3, Array] = vec3(estimate.nav[X.P]), so3.normalise(estimate.nav[X.Q])
        pose = self._local.pose(estimate, self._geoid_m, is_px4=True)
        if pose is None and self._has_none and self._from_ours:
            pose = ours
        quality, usable = self._policy.quality(estimate, one_source_at_a_time=False) if pose else (-1, False)
        (p, q), self._quality = pose or ours, quality
        counter = self._policy.reset_counter(estimate, p, usable=usable)
        return px4.vehicle_odometry(estimate, (p if usable or quality < 0 else None, q), sent_us, sample_us, counter, quality)

    def _tell_fix(self, estimate: Estimate, sent_us: int, sample_us: int) -> None:
        origin = Origin.of(estimate.origin)
        if origin is None or not self._config.fixes or not self._policy.is_fix(estimate):
            return
        lla, estimate = origin.to_geodetic(estimate.nav[X.P]), self._policy.widened(estimate)
        if self._config.release == "1.18":
            data = px4.aux_global_position(estimate, lla, self._geoid_m, sent_us, sample_us, self._config.slot)
        else:
            data = px4.vehicle_global_position(estimate, lla, self._geoid_m, sent_us, sample_us)
        self.sent_fixes += self._put(self._fix, data)

    def _put(self, publisher: zenoh.Publisher, data: bytes | None) -> bool:
        """Raises ZError; messages that do not fit are counted and dropped."""
        if data is None:
            self.out_of_range += 1
            return False
        publisher.put(data)
        return True

    def _hear(self, sample: zenoh.Sample) -> None:
        """The attachment is stamped later than the message."""
        arrived_ns = self._clock.now_ns()
        attachment, payload = sample.attachment, sample.payload.to_bytes()
        if attachment is not None and len(attachment) == _SENT.size:
            (sent_us,) = _SENT.unpack(attachment.to_bytes())
        elif len(payload) >= _TIMESTAMP.size:
            (sent_us,) = _TIMESTAMP.unpack_from(payload)
        else:
            return
        before = self._boot.reboots
        heard = self._boot.t_ns(sent_us * _US, arrived_ns) is not None
        if self._boot.reboots != before:
            self._local.forget()
            self._has_none = True
        if heard:
            self._heard_ns = arrived_ns
            if str(sample.key_expr) == self._local_key:
                self._hear_reference(payload, arrived_ns)
            elif self._landed is not None and _LANDED in str(sample.key_expr) and (landed := px4.landed(payload)) is not None:
                inbox, topic = self._landed
                inbox.put(Reading(arrived_ns, arrived_ns, topic, "rest", (landed,)))
            elif self._feed is not None and f"{GNSS_TOPIC}/" in str(sample.key_expr):
                self._hear_receiver(payload)

    def _hear_receiver(self, payload: bytes) -> None:
        assert self._feed is not None
        inbox, *takes = self._feed
        if (read := px4.receiver(payload, self._geoid_m, GNSS_TOPIC)) is None:
            return
        *both, self._reception = read
        for measured, is_taken in zip(both, takes, strict=True):
            if is_taken and measured and (t_ns := self._boot.offset.ours(measured.t_ns)) is not None:
                inbox.put(replace(measured, t_ns=t_ns, arrived_ns=t_ns))

    def _hear_reference(self, payload: bytes, arrived_ns: int) -> None:
        place = px4.local_reference(payload)
        self._reference_ns, self._has_none = arrived_ns, place is None
        if place is None:
            self._local.forget()
            return
        try:
            self._local.hear(*place)
        except ValueError:
            self._local.forget()
            self.implausible_references += 1
