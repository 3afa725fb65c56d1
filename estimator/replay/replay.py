"""A log through the estimator, to the bits of a flight with this configuration.

Output: the input byte for byte, without earlier outputs, and behind each message what it caused.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Protocol

import msgspec

from estimator.fusion import Fusion, FusionConfig
from estimator.publish import OutputConfig, Publisher
from estimator.replay.summary import ReplaySummary, SummaryBuilder
from estimator.version import version
from logs.store.parts import PartsReader, files_of
from logs.store.reader import Attachment, LogError, Record
from logs.store.recorder import CONFIG_ATTACHMENT, FINDINGS_ATTACHMENT, Recorder
from logs.wire import schemas
from logs.wire.codec import Decoder, is_own_transform
from models.messages import OdometryDelta, OdometryPose, Output

Message = tuple[str, str, bytes, int]  # topic, type, CDR, arrival

TF_TOPIC = "/tf"
OWN_PREFIX = "/landfix/"
OWN_INPUTS = frozenset({  # what stands under our own prefix, and no replay of ours makes anew
    "/landfix/fix", "/landfix/vision", "/landfix/vision_request", "/landfix/landmarks", "/landfix/tick", "/landfix/checkpoint",
    "/landfix/odometry_delta", "/landfix/odometry_request", "/landfix/odometry_report",
    "/landfix/left/camera_info", "/landfix/right/camera_info",
})  # fmt: skip
_PROGRESS_EVERY = 2000  # records
_FINDINGS = FINDINGS_ATTACHMENT.partition("/")[0]


class ReplayConfig(Protocol):
    """Configuration of a replay (estimator.config.Config)."""

    @property
    def output(self) -> OutputConfig:
        """Rates of the outputs."""
        ...

    def fusion(self) -> FusionConfig:
        """The parameters of Fusion."""
        ...

    def decoder(self) -> Decoder:
        """Decoder of the configured topics."""
        ...

    def toml(self) -> str:
        """All of it as text."""
        ...


class SeesAgain(Protocol):
    """Processes a log's images again (estimator.frontend.replay_images.ImageReplay)."""

    def records(self, record: Record) -> Iterable[Record]:
        """Records for the estimator in place of this one."""
        ...

    def note(self, outputs: Iterable[Output]) -> None:
        """Note Fusion's outputs."""
        ...


def replay(
    source: Path | Sequence[Path],
    out: Path,
    config: ReplayConfig,
    progress: Callable[[float], None] | None = None,
    processor: SeesAgain | None = None,
    attachments: Sequence[Attachment] = (),
    *,
    odometry: bool = True,
) -> ReplaySummary:
    """Replay `source` (parts, or their folder) into `out`; progress: fraction done. Raises LogError.

    processor: None: logged fixes; attachments: replace the log's; odometry: whether used.
    """
    parts = files_of(source)
    if out.exists() and any(part.exists() and out.samefile(part) for part in parts):
        raise LogError(f"{out}: the output would overwrite the input; name another file after -o")
    builder = SummaryBuilder(config.fusion().origin)
    text = config.toml().encode()
    began = time.perf_counter()
    metadata = {"version": version(), "config_sha256": sha256(text).hexdigest()}
    kept = [Attachment(CONFIG_ATTACHMENT, "application/toml", text), *attachments]
    with PartsReader(parts) as reader, Recorder(out, metadata=metadata, schemas=reader.schemas) as recorder:
        for attachment in kept:
            recorder.attach(*attachment)
        for message in logged(reader, config, builder, processor, odometry=odometry):
            recorder.write(*message)
            if progress and builder.records % _PROGRESS_EVERY == 0:
                progress(reader.fraction)
        if found := builder.findings():
            kept.append(Attachment(FINDINGS_ATTACHMENT, "application/json", msgspec.json.encode(found)))
            recorder.attach(*kept[-1])
        kinds = {_FINDINGS, *(_kind(attachment) for attachment in kept)}
        for attachment in reader.attachments:
            if _kind(attachment) not in kinds:
                recorder.attach(*attachment)
    return builder.summary(time.perf_counter() - began, reader.torn, reader.skipped_chunks, reader.missing, reader.imported_as)


def logged(
    records: Iterable[Record],
    config: ReplayConfig,
    builder: SummaryBuilder,
    processor: SeesAgain | None = None,
    *,
    odometry: bool = True,
) -> Iterator[Message]:
    """Each record but earlier outputs, and the outputs it caused."""
    fusion, decoder, publisher = Fusion(config.fusion()), config.decoder(), Publisher(config.output)
    for record in (seen for read in records for seen in (processor.records(read) if processor else (read,))):
        topic, schema, log_time_ns, data = record.topic, record.schema, record.log_time_ns, record.data
        if _is_own_output(topic, schema, data):
            continue
        yield topic, schema, data, log_time_ns
        builder.record(log_time_ns)
        message = decoder.decode(topic, schema, data, log_time_ns)
        if message is not None and (odometry or not isinstance(message, OdometryDelta | OdometryPose)):
            outputs = fusion.handle(message)
            builder.step(message, outputs)
            if processor:
                processor.note(outputs)
            for encoded in publisher.encoded(outputs):
                yield *encoded, log_time_ns


def _kind(attachment: Attachment) -> str:
    return attachment.name.partition("/")[0]


def _is_own_output(topic: str, schema: str, data: bytes) -> bool:
    if topic == TF_TOPIC and schema == schemas.TF:
        return is_own_transform(data)
    return topic.startswith(OWN_PREFIX) and topic not in OWN_INPUTS
