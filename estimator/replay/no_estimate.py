"""Why a replay made no estimate, and what to change, in one line."""

from collections.abc import Mapping
from typing import Final

from models.messages import Reason

_LOWEST_IMU_RATE_HZ: Final = 40.0
_LOG_FASTER: Final[dict[str, str]] = {  # kind of the imported log -> parameters that make its IMU and GNSS dense enough
    "ulog": "in PX4 set SDLOG_PROFILE with bit 4 (high rate), as 17, and SDLOG_MODE = 1 to log from boot on",
    "dataflash": "in ArduPilot tick GPS and Fast IMU in LOG_BITMASK, and set LOG_DISARMED = 1 to log before take-off too",
    "tlog": (
        "raise the MAVLink stream rates "
        "(ArduPilot: SR0_RAW_SENS = 50, SR0_POSITION = 10; PX4: mavlink stream -s HIGHRES_IMU -r 100), "
        "or import the autopilot's own log (.bin, .ulg)"
    ),
}
_ANY_LOG: Final = "record the IMU at 100 Hz or more, and GNSS or pose fixes with it"
_TAKEN: Final = frozenset({Reason.ALIGNING, Reason.FUSED, Reason.THINNED})


def advice(
    kind: str,
    imu_samples: int,
    positions: int,
    duration_s: float,
    fixes: Mapping[str, Mapping[str, int]],
    details: Mapping[str, str],
    waited_for: str,
) -> str:
    """kind: of importer; positions: messages with one; fixes: topic -> reason -> measurements; details: topic -> last refusal;
    waited_for: at last.
    """
    log_faster = _LOG_FASTER.get(kind, _ANY_LOG)
    if imu_samples < 2:
        return f"no IMU sample in the log: name its topic in [inputs] imu (landfix doctor LOG lists them), or {log_faster}"
    if slow := too_slow(kind, imu_samples, duration_s):
        return slow
    malformed = {topic: sum(reasons.values()) for topic, reasons in fixes.items() if set(reasons) == {Reason.MALFORMED}}
    if not positions and malformed:
        topic = max(malformed, key=malformed.__getitem__)
        return f"no GNSS or pose fix in the log that can be read: {topic}, {malformed[topic]} of them ({details.get(topic, '')})"
    if not positions and kind in _LOG_FASTER:
        return f"no GNSS position in the log: fly with a receiver that the autopilot logs, and {log_faster}"
    if not positions:
        return f"no GNSS or pose fix in the log: name their topics in [inputs] (landfix doctor LOG lists them), or {log_faster}"
    refused = {topic: reasons for topic, reasons in fixes.items() if not _TAKEN & set(reasons)}
    if refused:
        topic, reasons = max(refused.items(), key=lambda item: sum(item[1].values()))
        reason, count = max(reasons.items(), key=lambda item: item[1])
        why = details.get(topic, "")
        words = f"{count} of {sum(reasons.values())} as {reason}" + (f" ({why})" if why else "")
        return f"every measurement of {topic} was refused, {words}; mend what writes this topic"
    autopilot = "begin with the autopilot's attitude ([inputs] attitude, see the .toml of the import)"
    what_to_do = autopilot if kind in _LOG_FASTER else "turn and accelerate while fixes come"
    return f"{waited_for or 'the alignment has not ended'}; {what_to_do}"


def too_slow(kind: str, imu_samples: int, duration_s: float) -> str:
    """Advice on an IMU with too few samples; empty if enough."""
    rate_hz = imu_samples / max(duration_s, 1e-9)
    if rate_hz >= _LOWEST_IMU_RATE_HZ:
        return ""
    return f"{rate_hz:.1f} IMU samples a second, {_LOWEST_IMU_RATE_HZ:g} or more are needed: {_LOG_FASTER.get(kind, _ANY_LOG)}"
