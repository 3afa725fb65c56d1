"""Is a log fit for a replay?"""

import math
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from estimator.config import Config, Inputs
from estimator.fusion import Fusion
from estimator.replay.summary import SummaryBuilder
from estimator.sources.aids import aid_of
from estimator.sources.base.aid import Aid, Refusal
from estimator.tools.doctor.machine import Check, judge
from estimator.tools.doctor.noise import Noise
from logs.findings import Watch, together
from logs.store.reader import LogError, LogReader
from logs.store.recorder import METADATA_NAME
from logs.wire.sensors import SENSORS
from models.frames import GRAVITY, Origin
from models.messages import ATTITUDE_TOPIC, Array, Estimate, ImuSample, Input, Reading, Reason, Unusable

_SCHEMAS = {  # what a topic must carry to feed an input
    "imu": "sensor_msgs/msg/Imu",
    "gnss": "sensor_msgs/msg/NavSatFix",
    "gnss_velocity": "geometry_msgs/msg/TwistWithCovarianceStamped",
    "pose_fix": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "odometry": "nav_msgs/msg/Odometry",
    **{kind: sensor.schema for kind, sensor in SENSORS.items()},
}
_DEFAULTS = Inputs()
_LOWEST_IMU_RATE_HZ = 40.0
_IMU_GAP_S = 0.1
_LATEST_S = 6.0  # measurements later than this are too old for the default history
_STILL_WINDOW_S = 1.0
_GRAVITY_BAND = (9.3, 10.3)  # m/s^2, mean over the stillest second
_FASTEST_RAD_S = 40.0  # 2300 deg/s: beyond the range of flight gyroscopes
_SWIFT_RAD_S = 3.0
_FEW_SPIKES = 1e-3  # of all samples; in deg/s more are beyond
_USUAL = Reason.NO_FIX, Reason.THINNED


class _Topic:
    def __init__(self, schema: str) -> None:
        self.schema = schema
        self.stamps: list[int] = []
        self.arrivals: list[int] = []
        self.bad: list[str] = []
        self.slow = False  # an airspeed below the least one: usual on the ground
        self.count = 0
        self.assumed = ""
        self.assumptions = 0

    def add(self, message: Input, made: Aid | Refusal | None) -> None:
        self.count += 1
        if isinstance(message, Unusable):
            self.bad.append(message.detail)
        else:
            if isinstance(made, Refusal) and not (made.reason in _USUAL or _no_echo(message)):
                self.bad.append(f"{made.reason} {made.detail}".strip())
                self.slow = isinstance(message, Reading) and message.kind == "airspeed" and made.reason is Reason.IMPLAUSIBLE
            elif isinstance(made, Aid) and made.assumed:
                self.assumed, self.assumptions = made.assumed, self.assumptions + 1
            self.stamps.append(message.t_ns)
            self.arrivals.append(message.arrived_ns)


def log(
    path: Path, config: Config, progress: Callable[[float], None] | None = None, *, live: Mapping[str, str] | None = None
) -> list[Check]:
    """All checks of one log; live: topics, with their types, that are published where it has just been recorded, at rest."""
    topics: dict[str, _Topic] = {}
    imu: dict[str, list[tuple[float, ...]]] = {}
    decoder, sources, alignment, watch = config.decoder(), config.fusion(), _Alignment(config), Watch(config.map.origin)
    noise = Noise(Origin(*config.map.origin) if config.map.origin else None)
    try:
        with LogReader(path) as reader:
            for count, record in enumerate(reader):
                topic = topics.setdefault(record.topic, _Topic(record.schema))
                message = decoder.decode(record.topic, record.schema, record.data, record.log_time_ns)
                if message is not None:
                    made = aid_of(message, sources)
                    topic.add(message, made)
                    if live is not None:
                        noise.add(message, made)
                    watch.add(message)
                    alignment.step(message, record.log_time_ns)
                if isinstance(message, ImuSample):
                    imu.setdefault(message.topic, []).append((*message.gyro_b, *message.accel_b))
                if progress and count % 2000 == 0:
                    progress(reader.fraction)
            torn, skipped = reader.torn, reader.skipped_chunks
            kind = reader.metadata.get(METADATA_NAME, {}).get("import_kind", "")
    except LogError as error:
        return [
            judge("log", str(error), fail=True, advice="landfix recover may save the whole records" if path.is_file() else "")
        ]
    found = (
        f"{path}: {len(topics)} topics"
        + (", torn at its end" if torn else "")
        + (f", {skipped} chunks damaged" if skipped else "")
    )
    checks = [judge("log", found, warn=torn or skipped > 0, advice="landfix recover BROKEN.mcap -o WHOLE.mcap")]
    checks += _inputs({name: topic.schema for name, topic in topics.items()}, config, live)
    checks += _at_fault(watch)
    for name, topic in sorted(topics.items()):
        if topic.stamps or topic.bad:
            checks += _stream(name, topic)
    checks += noise.checks(config)
    for name, rows in sorted(imu.items()):
        checks += _imu(name, np.array(rows), np.array(topics[name].stamps) * 1e-9, config.imu.axes)
    return [*checks, alignment.judged(kind)]


class _Alignment:
    def __init__(self, config: Config) -> None:
        self._fusion, self._builder, self._aligned = Fusion(config.fusion()), SummaryBuilder(), False

    def step(self, message: Input, log_time_ns: int) -> None:
        if not self._aligned:
            self._builder.record(log_time_ns)
            outputs = self._fusion.handle(message)
            self._builder.step(message, outputs)
            self._aligned = any(isinstance(output, Estimate) for output in outputs)

    def judged(self, kind: str) -> Check:
        summary = self._builder.summary(0.0, [], 0, "", kind)
        if summary.first_estimate_s is None:
            return judge("alignment", "this log leads to no estimate", fail=True, advice=summary.advice)
        return judge("alignment", f"first estimate {summary.first_estimate_s:.1f} s after the log's first measurement")


def _of_receiver(topic: str, used: set[str]) -> bool:
    return topic.endswith("/velocity") and topic.rpartition("/")[0] in used


def _inputs(topics: Mapping[str, str], config: Config, live: Mapping[str, str] | None) -> list[Check]:
    """topics: those that came, with their types."""
    checks = []
    used = {t for name in _SCHEMAS for t in getattr(config.inputs, name)}
    for name, schema in _SCHEMAS.items():
        wanted: tuple[str, ...] = getattr(config.inputs, name)
        absent = [t for t in wanted if t not in topics]
        of_type = [t for t, other in {**topics, **(live or {})}.items() if other == schema and t != ATTITUDE_TOPIC]  # no position
        others = sorted(t for t in of_type if t not in used and not _of_receiver(t, used) and not t.startswith("/landfix/"))
        found = ", ".join([*(t for t in wanted if t in topics), *(f"{t} did not come" for t in absent)]) or "off"
        advice = f"no {schema} came: is its driver running?"
        if name == "odometry":  # may be an estimate that rests on GNSS, or the truth
            others = []
        if others:
            advice = f'other topics of its type are here: set [inputs] {name} = "{others[0]}"'
        nothing = len(absent) == len(wanted) and (name == "imu" or bool(others))
        lacks = bool(absent) and live is not None and wanted != getattr(_DEFAULTS, name)
        checks.append(judge(f"inputs.{name}", found, fail=nothing and name == "imu", warn=nothing or lacks, advice=advice))
    absolute = [t for name in ("gnss", "pose_fix", "beacon") for t in getattr(config.inputs, name) if t in topics]
    absolute += [t for t in ("/landfix/fix",) if t in topics]
    advice = "IMU alone drifts within seconds: name a GNSS or pose topic in [inputs]"
    checks.append(judge("absolute source", ", ".join(absolute) or "none", fail=not absolute, advice=advice))
    return checks


def _no_echo(message: Input) -> bool:
    """A range finder out of its range: +inf, as REP 117 has it."""
    return isinstance(message, Reading) and message.kind == "range" and message.values[0] == math.inf


def _at_fault(watch: Watch) -> list[Check]:
    return [
        judge(f"{f.who} at fault", f"since {f.since_s:.1f} s: {f.what}", fail=True, advice=f.advice)
        for f in together(watch.findings())
    ]


def _stream(name: str, topic: _Topic) -> list[Check]:
    checks = []
    if topic.bad:
        found = f"{len(topic.bad)} of {topic.count} unusable, the first: {topic.bad[0]}"
        fail = len(topic.bad) == topic.count and not topic.slow
        checks.append(judge(f"{name} content", found, fail=fail, warn=True, advice="see what writes this topic"))
    if topic.assumed:
        found = f"{topic.assumptions} of {topic.count}: {topic.assumed}"
        checks.append(
            judge(f"{name} accuracy", found, warn=True, advice="let the driver report it, or set what fits the receiver")
        )
    if not topic.stamps:
        return checks
    t, arrived = np.array(topic.stamps), np.array(topic.arrivals)
    span = (t.max() - t.min()) * 1e-9
    rate = f"{(len(t) - 1) / span:.1f} Hz" if span > 0 else "one stamp"
    backward, delay = int(np.count_nonzero(np.diff(t) < 0)), (arrived - t) * 1e-9
    late, early = int(np.count_nonzero(delay > _LATEST_S)), int(np.count_nonzero(delay < -1e-3))
    order = f"{backward} backward steps" if backward else "in order"
    imu = topic.schema == _SCHEMAS["imu"]
    checks.append(
        judge(f"{name} stamps", f"{len(t)} at {rate}, {order}", warn=imu and backward > 0, advice="IMU stamps must grow")
    )
    found = f"median {np.median(delay) * 1e3:.1f} ms, 99 % below {np.quantile(delay, 0.99) * 1e3:.1f} ms"
    trouble = f", {late} later than {_LATEST_S:.0f} s" * (late > 0) + f", {early} before their stamp" * (early > 0)
    advice = "the sender's clock is off, or header.stamp is not the time of validity"
    checks.append(judge(f"{name} delay", found + trouble, fail=early + late > len(t) // 2, warn=early + late > 0, advice=advice))
    return checks


def _imu(name: str, samples: Array, t_s: Array, axes: str) -> list[Check]:
    finite = np.isfinite(samples).all(axis=1)
    bad = int(np.count_nonzero(~finite))
    samples, t_s = samples[finite], t_s[finite]
    steps = np.diff(t_s)
    steps = steps[steps > 0]
    if len(steps) == 0:
        return [
            judge(
                f"{name} samples", f"{len(samples)} usable", fail=True, advice="an IMU stream has many samples and growing stamps"
            )
        ]
    rate, gaps = 1.0 / float(np.median(steps)), int(np.count_nonzero(steps > _IMU_GAP_S))
    found = f"{rate:.0f} Hz, {gaps} gaps over {_IMU_GAP_S} s, {bad} samples not finite"
    trouble = rate < _LOWEST_IMU_RATE_HZ or gaps > 0 or bad > 0
    checks = [judge(f"{name} samples", found, warn=trouble, advice="landfix needs 100 Hz or more without gaps")]
    still = _stillest(samples, max(2, round(rate * _STILL_WINDOW_S)))
    checks.append(_gravity(name, float(np.linalg.norm(still[3:]))))
    checks.append(_turn_rate(name, np.linalg.norm(samples[:, :3], axis=1)))
    checks.append(_axes(name, still[3:], axes))
    return checks


def _stillest(samples: Array, width: int) -> Array:
    windows = samples[: len(samples) // width * width].reshape(-1, width, 6) if len(samples) >= width else samples[None]
    spread = windows.std(axis=1)
    score = spread[:, :3].sum(axis=1) + spread[:, 3:].sum(axis=1) / GRAVITY
    mean: Array = windows[int(np.argmin(score))].mean(axis=0)
    return mean


def _gravity(name: str, length: float) -> Check:
    low, high = _GRAVITY_BAND
    if 0.9 < length < 1.1:
        advice = "looks like g: landfix needs m/s^2"
    elif length < 1.0:
        advice = "gravity is missing: landfix needs specific force as the accelerometer measures it"
    else:
        advice = "wrong scale, or the vehicle was never still"
    found = f"{length:.2f} m/s^2 in its stillest second"
    return judge(f"{name} gravity", found, fail=not 0.5 * low < length < 2 * high, warn=not low < length < high, advice=advice)


def _turn_rate(name: str, rate: Array) -> Check:
    """Only spinning vehicles turn at 3 rad/s on average."""
    fastest, mean, beyond = float(rate.max()), float(rate.mean()), int(np.count_nonzero(rate > _FASTEST_RAD_S))
    wrong = beyond > _FEW_SPIKES * len(rate) or mean > _SWIFT_RAD_S
    found = f"{mean:.2f} rad/s on average, up to {fastest:.1f} rad/s" + (
        f", {beyond} samples beyond any gyroscope" if beyond else ""
    )
    advice = (
        "looks like deg/s: landfix needs rad/s" if wrong else "single implausible samples: faults of the IMU or of its driver"
    )
    return judge(f"{name} turn rate", found, fail=wrong, warn=beyond > 0, advice=advice)


def _axes(name: str, f_b: Array, axes: str) -> Check:
    tilt_deg = float(np.degrees(np.arccos(np.clip(-f_b[2] / max(np.linalg.norm(f_b), 1e-9), -1.0, 1.0))))
    if tilt_deg > 135.0:
        advice = f'the other convention fits: set [imu] axes = "{"frd" if axes == "flu" else "flu"}"'
    else:
        advice = "set [imu] mounting_rpy_deg, unless the vehicle really stood or flew that way"
    found = f"gravity {tilt_deg:.0f} degrees from body down, as configured"
    return judge(f"{name} axes", found, fail=tilt_deg > 135.0, warn=tilt_deg > 45.0, advice=advice)
