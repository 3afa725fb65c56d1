"""Flights in which 2, 20 or 60 % of the messages are spoiled, as records, as bytes, or as MAVLink frames.

Fields of the record (NaN, infinite, huge, denormal, negative), covariances (zero, asymmetric, indefinite), stamps (late, early,
twice, far away), then bytes (torn, longer, bits, counts of 2^32 - 1, another type). The last two seconds are whole.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple, TypeAlias

import msgspec
import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from benchmarks.service.autopilot import gps_raw_int, highres_imu
from benchmarks.service.vehicle import ORIGIN, gnss, imu, pose_fix, truth
from logs.wire import schemas
from logs.wire.codec import Encoded, encode_input
from models.measurements import DIRECTION_SCALE
from models.messages import (
    Array,
    AttitudePrior,
    Checkpoint,
    GnssFix,
    GnssVelocity,
    ImuSample,
    Input,
    LandmarkFix,
    PoseFix,
    Reading,
    Tick,
    Unusable,
)

SECOND: Final = 1_000_000_000
BEGIN_NS: Final = 1_795_000_000 * SECOND
_BOOTED_NS: Final = BEGIN_NS - 500 * SECOND  # of the autopilot
_DURATION_S, _IMU_HZ, _WHOLE_S = 10, 100, 2  # of a flight; its last seconds are not spoiled
_SHARES: Final = (0.02, 0.2, 0.6)
_TOPICS: Final = ("/imu", "/gnss", "/gnss/velocity", "/pose_fix", "/landfix/fix", "/baro", "/attitude", "/landfix/tick", "/x")
_SCHEMAS: Final = (schemas.IMU, schemas.NAV_SAT_FIX, schemas.TWIST, schemas.POSE_FIX, schemas.LANDMARK_FIX, schemas.HEADER, "a/b")
_NUMBERS: Final = (
    0.0, -0.0, 1.0, -1.0, math.nan, math.inf, -math.inf, 1e308, -1e308, 1e300, 1e150, -1e150, 1e30, 1e9, 1e6, 9e4, 10.0, 1e-9,
    1e-30, 1e-150, 1e-300, 5e-324,
)  # fmt: skip
_DELAYS_NS: Final = (0, 1, SECOND // 3, 3 * SECOND, 5_900_000_000, 6_100_000_000, 60 * SECOND, -SECOND // 2, -2 * SECOND)
_STAMPS_NS: Final = (0, 1, -1, -SECOND, 2**31 * SECOND - 1, -(2**31) * SECOND, 2**62, 2**63 - 1, 2**63, -(2**63), 2**64)

Rng: TypeAlias = np.random.Generator


class Datagram(NamedTuple):
    """Bytes for the MAVLink link; sender: 0 is the autopilot."""

    data: bytes
    sender: int


class Sent(NamedTuple):
    """One message, at its time. A record that no bytes can hold goes to the estimator as it is."""

    arrived_ns: int
    what: Input | Encoded | Datagram
    spoiled: bool


def per_flight() -> int:
    """Messages of a flight, or few more."""
    return _DURATION_S * (_IMU_HZ + 60)


def flight(rng: Rng, *, mavlink_too: bool) -> list[Sent]:
    """All messages of one flight in the order of arrival."""
    share, since_ns = float(rng.choice(_SHARES)), int(rng.choice([0, 4])) * SECOND
    sent: list[Sent] = []
    packer = _Packer(rng) if mavlink_too else None
    for message in _good(rng):
        age_ns = message.t_ns - BEGIN_NS
        spoils = since_ns <= age_ns < (_DURATION_S - _WHOLE_S) * SECOND and rng.random() < share
        if spoils:
            sent += _spoiled(rng, message.t_ns, packer)
        if not (spoils and rng.random() < 0.25):
            whole = packer.packed(message) if packer else None
            sent.append(Sent(message.arrived_ns, whole or encode_input(message), spoiled=False))
        if packer and age_ns % (SECOND // 10) == 0:
            sent += [Sent(message.t_ns, Datagram(data, 0), spoiled=False) for data in packer.company(message.t_ns)]
    return sorted(sent, key=lambda s: s.arrived_ns)


def _good(rng: Rng) -> Iterator[Input]:
    """The flight as it should be."""
    step_ns = SECOND // _IMU_HZ
    for k in range(_DURATION_S * _IMU_HZ):
        t_ns = BEGIN_NS + k * step_ns
        yield imu(t_ns, rng)
        for every, kind in ((5, "tick"), (10, "baro"), (20, "gnss"), (25, "landmark"), (50, "pose")):
            if k % every == 0:
                yield from (_late(m, rng) for m in _measured(kind, t_ns, rng))


def _late(message: Input, rng: Rng) -> Input:
    late_ns = 0 if isinstance(message, Tick) else int(rng.integers(0, SECOND // 5))
    return msgspec.structs.replace(message, arrived_ns=message.t_ns + late_ns)


def _measured(kind: str, t_ns: int, rng: Rng) -> list[Input]:
    if kind == "imu":
        return [imu(t_ns, rng)]
    if kind == "tick":
        return [Tick(t_ns, t_ns)]
    if kind == "baro":
        pa = 101_325.0 * (1.0 - 2.25577e-5 * (ORIGIN.alt_m + 40.0)) ** 5.25588 + rng.normal(0.0, 2.0)
        return [Reading(t_ns, t_ns, "/baro", "baro", (pa,), 4.0 * np.eye(1))]
    if kind == "gnss":
        return gnss(t_ns, rng)
    fix = pose_fix(t_ns, rng)
    if kind == "pose":
        return [fix]
    if kind == "attitude":
        return [AttitudePrior(t_ns, t_ns, fix.q_nb_wxyz, np.eye(3) * 0.01)]
    if kind == "checkpoint":
        p, v, _ = truth(t_ns)
        nav = np.concatenate([p, v, fix.q_nb_wxyz, np.zeros(6)])
        return [Checkpoint(t_ns, t_ns, nav, np.eye(15) * 0.01, t_ns, 0, ORIGIN.lla)]
    if kind == "unusable":
        return [Unusable(t_ns, t_ns, "/gnss", "torn")]
    return [_landmark(fix, rng)]


def _landmark(fix: PoseFix, rng: Rng) -> LandmarkFix:
    """On up to three roofs, one time in three known in part only; now and then on far too many."""
    count = int(rng.choice([1, 1, 2, 3, 3, 60]))
    names = tuple(f"roof {k}" for k in rng.integers(0, 6 if count < 10 else 500, count))
    errors = rng.normal(0.0, 0.05, (count, 6, int(rng.choice([3, 4]))))
    rig = np.eye(6) * 1e-4
    common = np.asarray((errors @ errors.transpose(0, 2, 1)).sum(axis=0) + rig)
    part = rng.random() < 1 / 3
    directions = np.eye(6)[:4] * DIRECTION_SCALE if part else None
    readings = rng.normal(0.0, 0.1, 4) if part else None
    given = fix.t_ns, fix.arrived_ns, fix.p_n, fix.q_nb_wxyz, fix.covariance
    return LandmarkFix(*given, common, names, 0.9, 0.5, errors, rig, directions, readings)


# --- spoiled ---------------------------------------------------------------------------------------------------------------

_KINDS: Final = (
    "imu", "imu", "tick", "baro", "gnss", "pose", "pose", "landmark", "landmark", "landmark", "attitude", "checkpoint",
    "unusable",
)  # fmt: skip


def _spoiled(rng: Rng, t_ns: int, packer: "_Packer | None") -> list[Sent]:
    if packer and rng.random() < 0.7:
        return [Sent(t_ns, Datagram(data, int(rng.random() < 0.05)), spoiled=True) for data in packer.spoiled(t_ns)]
    message = _pick(rng, _measured(str(rng.choice(_KINDS)), t_ns, rng))
    message = _spoiled_record(message, rng)
    arrived_ns = t_ns if rng.random() < 0.9 else message.arrived_ns
    arrived_ns = min(max(arrived_ns, BEGIN_NS), BEGIN_NS + _DURATION_S * SECOND)
    message = msgspec.structs.replace(message, arrived_ns=arrived_ns)
    try:
        encoded = encode_input(message)
    except Exception:  # no bytes can hold it
        return [Sent(arrived_ns, message, spoiled=True)]
    if rng.random() < 0.3:
        encoded = _spoiled_bytes(encoded, rng)
    return [Sent(arrived_ns, encoded, spoiled=True)] * (2 if rng.random() < 0.05 else 1)


def _spoiled_record(message: Any, rng: Rng) -> Any:
    """One or several fields exchanged."""
    names = [n for n in message.__struct_fields__ if n != "arrived_ns"]
    changes: dict[str, Any] = {}
    for name in rng.choice(names, int(rng.choice([1, 1, 1, 2, 3]))).tolist():
        changes[name] = _spoiled_value(name, getattr(message, name), message.t_ns, rng)
    return msgspec.structs.replace(message, **changes)


def _spoiled_value(name: str, value: Any, t_ns: int, rng: Rng) -> Any:
    if name in {"t_ns", "last_absolute_ns"}:
        return t_ns - _pick(rng, _DELAYS_NS) if rng.random() < 0.8 else _pick(rng, _STAMPS_NS)
    if name == "topic":
        return _pick(rng, _TOPICS)
    if name == "landmarks":
        return tuple(f"{k}" for k in range(int(rng.choice([0, 1, 3, 200])))) if rng.random() < 0.7 else ("a",) * 3
    match value:
        case str():
            return "\N{SNOWMAN}" * int(rng.choice([0, 1, 1000]))
        case bool() | int():
            return int(rng.choice([-1, 0, 1, 127, -128]))
        case float():
            return _pick(rng, _NUMBERS)
        case tuple():
            k = int(rng.integers(-1, len(value)))  # all of them, or one
            return tuple(_pick(rng, _NUMBERS) if k in {-1, j} else x for j, x in enumerate(value))
        case np.ndarray():
            return _spoiled_array(value, rng)
    return None if rng.random() < 0.5 else np.eye(int(rng.choice([3, 6])))


def _spoiled_array(a: Array, rng: Rng) -> Array | None:
    ways: list[Callable[[Array], Array | None]] = [
        np.zeros_like,
        lambda a: a * _pick(rng, (1e300, 1e-300, 1e150, 1e-150, 1e12, 1e-12, 1e6, 1e-6, -1.0, 1e4, 1e-4)),
        lambda a: np.full_like(a, _pick(rng, _NUMBERS)),
        lambda a: _with_entry(a, _pick(rng, _NUMBERS), rng),
        lambda a: _with_entry(_with_entry(a, _pick(rng, _NUMBERS), rng), _pick(rng, _NUMBERS), rng),
        lambda a: _with_line(a, _pick(rng, _NUMBERS), rng),
        lambda a: a + _pick(rng, (1e-12, 1e-6, 1.0, 1e6)) * rng.normal(size=a.shape),
        lambda a: _congruent(a, 10.0 ** rng.uniform(-12, 12, a.shape[-1])),
        lambda a: _congruent(np.full_like(a, 1.0), 10.0 ** rng.uniform(-6, 6, a.shape[-1])),
        lambda a: a[..., : max(1, a.shape[-1] // 2)],
        lambda a: np.tile(a, (2,) * a.ndim),
        lambda _: None,
    ]
    with np.errstate(all="ignore"):
        spoiled: Array | None = _pick(rng, ways)(a)
    return spoiled


def _with_entry(a: Array, value: float, rng: Rng) -> Array:
    a = a.copy()
    if a.size:
        a.flat[int(rng.integers(a.size))] = value
    return a


def _with_line(a: Array, value: float, rng: Rng) -> Array:
    """A row, and the column where there is one: a variable that is not given, or worse."""
    a = a.copy()
    k = int(rng.integers(min(a.shape[-1], a.shape[0])))
    a[k] = value
    a[..., k] = value
    return a


def _congruent(a: Array, scale: Array) -> Array:
    """Axes in other units: still symmetric, positive if it was, and badly conditioned."""
    return np.asarray(a * scale * scale[:, None]) if a.ndim == 2 and a.shape[0] == a.shape[1] else np.asarray(a * scale)


def _spoiled_bytes(encoded: Encoded, rng: Rng) -> Encoded:
    data = bytearray(encoded.data)
    at = int(rng.integers(max(1, len(data))))
    match int(rng.integers(8)):
        case 0:
            del data[at:]
        case 1:
            data += rng.bytes(int(rng.integers(1, 64)))
        case 2 if data:
            data[at] ^= 1 << int(rng.integers(8))
        case 3:
            aligned = at & ~7
            data[aligned + 4 : aligned + 12] = np.float64(_pick(rng, _NUMBERS)).tobytes()
        case 4:  # counts, among others
            data[at & ~3 : (at & ~3) + 4] = int(rng.choice([0, 1, 2**16, 2**31 - 1, 2**31, 2**32 - 1])).to_bytes(4, "little")
        case 5 if len(data) > 1:
            data[1] ^= 1  # the other byte order
        case 6:
            return encoded._replace(topic=_pick(rng, _TOPICS))
        case _:
            return encoded._replace(schema=_pick(rng, _SCHEMAS))
    return encoded._replace(data=bytes(data))


def _pick(rng: Rng, among: Any) -> Any:
    return among[int(rng.integers(len(among)))]


# --- MAVLink ---------------------------------------------------------------------------------------------------------------

_EXTREMES: Final = {"f": _NUMBERS, "d": _NUMBERS}
_BITS: Final = {"b": 8, "h": 16, "i": 32, "q": 64}
_HEARD: Final = (
    "HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "GPS_RAW_INT", "GPS2_RAW", "ATTITUDE", "HEARTBEAT", "TIMESYNC", "SYSTEM_TIME",
    "COMMAND_ACK",
)  # fmt: skip


class _Packer:
    """Frames of an autopilot."""

    def __init__(self, rng: Rng) -> None:
        self._rng, self._out = rng, mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._fix: GnssFix | None = None
        self._kinds = {kind.msgname: kind for kind in mavlink.mavlink_map.values()}

    def packed(self, message: Input) -> Datagram | None:
        """IMU and GNSS, the rest is Zenoh's."""
        match message:
            case ImuSample():
                return Datagram(self._pack(highres_imu(message, _boot_us(message.t_ns))), 0)
            case GnssFix():
                self._fix = message
            case GnssVelocity() if self._fix:
                return Datagram(self._pack(gps_raw_int(self._fix, message, _boot_us(message.t_ns))), 0)
        return None

    def company(self, t_ns: int) -> Iterator[bytes]:
        """What makes an autopilot known."""
        yield self._pack(mavlink.MAVLink_heartbeat_message(2, int(self._rng.choice([3, 12])), 0, 0, 4, 3))
        yield self._pack(mavlink.MAVLink_system_time_message(t_ns // 1000, _boot_us(t_ns) // 1000))

    def spoiled(self, t_ns: int) -> Iterator[bytes]:
        """A frame with fields exchanged, then perhaps torn."""
        rng = self._rng
        kind = self._kinds[_pick(rng, _HEARD)] if rng.random() < 0.9 else _pick(rng, list(self._kinds.values()))
        arguments = dict(zip(kind.fieldnames, self._arguments(kind), strict=True))
        if rng.random() < 0.7:  # a plausible stamp
            plausible = {"time_usec": _boot_us(t_ns), "time_boot_ms": _boot_us(t_ns) // 1000}
            arguments |= {name: plausible[name] for name in plausible.keys() & arguments}
        data = bytearray(self._pack(kind(**arguments)))
        match int(rng.integers(6)):
            case 0:
                del data[int(rng.integers(1, len(data))) :]
            case 1:
                data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
            case 2:
                data += data[: int(rng.integers(1, len(data)))]
        yield bytes(data)

    def _arguments(self, kind: Any) -> Iterator[Any]:
        for name in kind.fieldnames:
            k = kind.ordered_fieldnames.index(name)
            letter, count = kind.native_format.decode()[1 + k], kind.array_lengths[k]
            if letter == "c":
                yield b"x" * count
            elif count:
                yield [self._value(letter) for _ in range(count)]
            else:
                yield self._value(letter)

    def _value(self, letter: str) -> Any:
        if letter in _EXTREMES:
            value = _pick(self._rng, _NUMBERS)
            return value if letter == "d" or not math.isfinite(value) else float(np.clip(value, -3e38, 3e38))
        bits = _BITS[letter.lower()]
        low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if letter.islower() else (0, 2**bits - 1)
        return _pick(self._rng, (low, high, 0, 1, high // 2, int(self._rng.integers(0, 100))))

    def _pack(self, message: Any) -> bytes:
        data = bytes(message.pack(self._out))
        self._out.seq = (self._out.seq + 1) % 256
        return data


def _boot_us(t_ns: int) -> int:
    return max(0, t_ns - _BOOTED_NS) // 1000
