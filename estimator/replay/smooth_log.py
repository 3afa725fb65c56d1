"""A log with the smoothed flight added on /landfix/smoothed."""

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Protocol

import msgspec
import numpy as np

from estimator.filter.smoother import Smoothed, smooth
from estimator.fusion import Fusion, FusionConfig
from estimator.sources.imu.choice import KIND
from estimator.version import version
from logs.store.reader import LogError, LogReader
from logs.store.recorder import Recorder
from logs.wire.codec import Decoder, Encoded, encode
from models.messages import AidStatus, Estimate, ImuSample, Input, Mode, vec3

TOPIC = "/landfix/smoothed"
CONFIG_ATTACHMENT = "smoothed.toml"
_PROGRESS_EVERY = 2000  # records
_READ, _CHOSEN, _SMOOTHED = 0.2, 0.4, 0.7  # fractions of the work: the file is read, the IMU chosen, the flight smoothed


class SmoothLogConfig(Protocol):
    """Configuration of smoothing (estimator.config.Config)."""

    def fusion(self) -> FusionConfig:
        """The parameters of the estimator."""
        ...

    def decoder(self) -> Decoder:
        """Decoder of the configured topics."""
        ...

    def toml(self) -> str:
        """All of it as text."""
        ...


class SmoothSummary(msgspec.Struct, frozen=True):
    """largest 1-sigma of a position in any direction, m."""

    nodes: int
    segments: int
    worst_sigma_m: float
    torn: bool


def write_smoothed(
    source: Path, out: Path, config: SmoothLogConfig, progress: Callable[[float], None] | None = None
) -> SmoothSummary:
    """Smooth the log `source` into `out`; progress: fraction done. Raises LogError.

    out: the source's messages and /landfix/smoothed, logged at the next IMU sample.
    """
    if source.exists() and out.exists() and out.samefile(source):
        raise LogError(f"{out}: the output would overwrite the input; name another file after -o")
    tell = progress or (lambda _: None)
    read = _read(source, config.decoder(), lambda fraction: tell(_READ * fraction))
    messages = of_one_imu(read, config.fusion(), lambda fraction: tell(_READ + (_CHOSEN - _READ) * fraction))
    smoothed = smooth(messages, config.fusion(), lambda fraction: tell(_CHOSEN + (_SMOOTHED - _CHOSEN) * fraction))
    arrivals = _arrivals(smoothed, messages)
    text = config.toml().encode()
    metadata = {"version": version(), "config_sha256": sha256(text).hexdigest()}
    with LogReader(source) as reader, Recorder(out, metadata=metadata, schemas=reader.schemas) as recorder:
        recorder.attach(CONFIG_ATTACHMENT, "application/toml", text)
        written = 0
        for k, record in enumerate(reader):
            while written < len(arrivals) and arrivals[written] < record.log_time_ns:
                recorder.write(*_encoded(smoothed, written, arrivals[written]), arrivals[written])
                written += 1
            if record.topic != TOPIC:
                recorder.write(record.topic, record.schema, record.data, record.log_time_ns)
            if k % _PROGRESS_EVERY == 0:
                tell(_SMOOTHED + (1.0 - _SMOOTHED) * reader.fraction)
        for row in range(written, len(arrivals)):
            recorder.write(*_encoded(smoothed, row, arrivals[row]), arrivals[row])
        for name, media_type, content in reader.attachments:
            if name != CONFIG_ATTACHMENT:
                recorder.attach(name, media_type, content)
        tell(1.0)
        return _summary(smoothed, reader.torn)


def _read(source: Path, decoder: Decoder, tell: Callable[[float], None]) -> list[Input]:
    messages: list[Input] = []
    with LogReader(source) as reader:
        for k, record in enumerate(reader):
            message = decoder.decode(record.topic, record.schema, record.data, record.log_time_ns)
            if message is not None:
                messages.append(message)
            if k % _PROGRESS_EVERY == 0:
                tell(reader.fraction)
    return messages


def of_one_imu(messages: list[Input], config: FusionConfig, tell: Callable[[float], None] = lambda _: None) -> list[Input]:
    """Only samples of the IMU that led longest, by a second estimation."""
    if len(config.imu_topics) < 2:
        return messages
    fusion, led = Fusion(config), dict[int, str]()  # topics by the time from which they led
    for k, m in enumerate(messages):
        led |= {out.t_ns: out.topic for out in fusion.handle(m) if isinstance(out, AidStatus) and out.kind == KIND}
        if k % _PROGRESS_EVERY == 0:
            tell(k / len(messages))
    stamps = [m.t_ns for m in messages if isinstance(m, ImuSample)]
    begins = [(-(2**62), config.imu_topics[0]), *sorted(led.items())]
    ends = [t_ns for t_ns, _ in begins[1:]] + [max(stamps, default=0)]
    first_ns = min(stamps, default=0)
    spans = [(max(begin, first_ns), end, topic) for (begin, topic), end in zip(begins, ends, strict=True)]
    begin_ns, end_ns, topic = max(spans, key=lambda span: span[1] - span[0])
    return [m for m in messages if not isinstance(m, ImuSample) or (m.topic == topic and begin_ns <= m.t_ns <= end_ns)]


def _arrivals(smoothed: Smoothed, messages: list[Input]) -> list[int]:
    imu = sorted((m.t_ns, m.arrived_ns) for m in messages if isinstance(m, ImuSample))
    t_ns, arrived_ns = np.array(imu, np.int64).reshape(-1, 2).T
    rows = np.searchsorted(t_ns, smoothed.t_ns)
    known: list[int] = np.maximum.accumulate(arrived_ns[rows]).tolist()
    return known


def _encoded(smoothed: Smoothed, row: int, arrived_ns: int) -> Encoded:
    t_ns = int(smoothed.t_ns[row])
    estimate = Estimate(
        t_ns, arrived_ns, smoothed.nav[row], smoothed.covariance[row], vec3(smoothed.gyro_b[row]), Mode.AIDED, 0, t_ns
    )
    return encode(estimate)[0]._replace(topic=TOPIC)


def _summary(smoothed: Smoothed, torn: bool) -> SmoothSummary:
    largest = np.linalg.eigvalsh(smoothed.covariance[:, :3, :3])[:, -1].max(initial=0.0)
    return SmoothSummary(len(smoothed.t_ns), len(set(smoothed.segment.tolist())), float(np.sqrt(largest)), torn)
