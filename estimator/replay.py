"""A log through the estimator: what a flight with this configuration would have published, to the same bits.

The output holds the input's messages byte for byte (its own earlier /landfix outputs left out) and behind each the outputs
it caused, at the log time of its arrival. Nothing in it depends on when, where or how often the replay ran, so replaying
an output gives the same file again.
"""

import time
from collections.abc import Callable, Iterable
from hashlib import sha256
from pathlib import Path
from typing import Protocol

from estimator.fusion import Fusion, FusionConfig
from estimator.publish import CONFIG_ATTACHMENT, OutputConfig, Publisher
from estimator.tally import ReplaySummary, Tally
from estimator.version import version
from logs import schemas
from logs.codec import Decoder, is_own_transform
from logs.reader import LogError, LogReader, Record
from logs.recorder import Recorder
from models.messages import Output

TF_TOPIC = "/tf"
OWN_PREFIX = "/landfix/"
OWN_INPUTS = frozenset({  # what stands under our own prefix, and no replay of ours makes anew
    "/landfix/fix", "/landfix/vision", "/landfix/vision_request", "/landfix/landmarks", "/landfix/tick", "/landfix/checkpoint",
})  # fmt: skip
_PROGRESS_EVERY = 2000  # records


class ReplayConfig(Protocol):
    """What a replay needs of the configuration (estimator.config.Config has it)."""

    @property
    def output(self) -> OutputConfig:
        """What is published how often."""
        ...

    def fusion(self) -> FusionConfig:
        """The parameters of Fusion."""
        ...

    def decoder(self) -> Decoder:
        """Which topics are read, and how."""
        ...

    def toml(self) -> str:
        """All of it as text."""
        ...


class SeesAgain(Protocol):
    """What looks at the pictures of the log again (estimator.sight_replay.SightReplay)."""

    def records(self, record: Record) -> Iterable[Record]:
        """What the estimator is to see instead of this record."""
        ...

    def note(self, outputs: Iterable[Output]) -> None:
        """What Fusion said."""
        ...


def replay(
    source: Path,
    out: Path,
    config: ReplayConfig,
    progress: Callable[[float], None] | None = None,
    sight: SeesAgain | None = None,
) -> ReplaySummary:
    """Replay the log `source` into `out`; progress is told the fraction done. Raises LogError for a file that is no log.

    sight: looks at the pictures of the log again; None: the fixes in it are taken.
    """
    if source.exists() and out.exists() and out.samefile(source):
        raise LogError(f"{out}: the output would overwrite the input; name another file after -o")
    fusion, decoder, publisher, tally = Fusion(config.fusion()), config.decoder(), Publisher(config.output), Tally()
    text = config.toml().encode()
    began = time.perf_counter()
    metadata = {"version": version(), "config_sha256": sha256(text).hexdigest()}
    with LogReader(source) as reader, Recorder(out, metadata=metadata, schemas=reader.schemas) as recorder:
        recorder.attach(CONFIG_ATTACHMENT, "application/toml", text)
        for record in (seen for read in reader for seen in (sight.records(read) if sight else (read,))):
            topic, schema, log_time_ns, data = record.topic, record.schema, record.log_time_ns, record.data
            if _is_own_output(topic, schema, data):
                continue
            recorder.write(topic, schema, data, log_time_ns)
            tally.record(log_time_ns)
            message = decoder.decode(topic, schema, data, log_time_ns)
            if message is not None:
                outputs = fusion.handle(message)
                tally.step(message, outputs)
                if sight:
                    sight.note(outputs)
                for encoded in publisher.encoded(outputs):
                    recorder.write(*encoded, log_time_ns)
            if progress and tally.records % _PROGRESS_EVERY == 0:
                progress(reader.fraction)
        for name, media_type, content in reader.attachments:
            if name != CONFIG_ATTACHMENT:
                recorder.attach(name, media_type, content)
    return tally.summary(time.perf_counter() - began, reader.torn, reader.skipped_chunks)


def _is_own_output(topic: str, schema: str, data: bytes) -> bool:
    """Whether a message of the input is what an earlier run of ours published. /tf is shared: only map -> base_link is ours."""
    if topic == TF_TOPIC and schema == schemas.TF:
        return is_own_transform(data)
    return topic.startswith(OWN_PREFIX) and topic not in OWN_INPUTS
