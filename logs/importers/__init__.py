"""Logs of other programs -> an MCAP log and its configuration.

    csv        a folder of CSV files             euroc      the folder layout of ASL data sets
    ulog       PX4                               dataflash  ArduPilot, on board                    tlog   MAVLink, on the ground
    rosbag     ROS 2 and ROS 1 bags, copied message by message

An importer: `read(source, options, progress) -> Recording`. May import logs.store, logs.wire, models.
"""

from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path, PurePath

from logs.findings import Watch
from logs.importers.recording import DEFAULTS, ImportOptions, Message, Progress, Recording, Truth
from logs.importers.summary import ImportSummary
from logs.store.reader import LogError
from logs.store.recorder import REFERENCE_ATTACHMENT, Recorder
from logs.wire.encoding import Encoded, encode_input, encode_truth
from logs.wire.sensors import SENSORS
from models.messages import ATTITUDE_TOPIC
from models.untrusted import foreign
from models.untrusted.boundary import refusing
from models.untrusted.file import opened

__all__ = [
    "KINDS",
    "ROSBAG",
    "ImportOptions",
    "ImportSummary",
    "Recording",
    "Truth",
    "convert",
    "kind_of",
    "kind_of_name",
    "read",
]

ROSBAG = "rosbag"
KINDS = {"csv": "csv_folder", "euroc": "euroc", "ulog": "ulog", "dataflash": "dataflash", "tlog": "tlog"}

_SUFFIXES = {".ulg": "ulog", ".bin": "dataflash", ".tlog": "tlog", ".bag": ROSBAG, ".db3": ROSBAG}
_PROGRESS_EVERY = 2000  # messages
_READING = 0.3  # its share of the work


def kind_of_name(name: str) -> str | None:
    """Kind by the name's ending, or None."""
    return _SUFFIXES.get(PurePath(name).suffix.lower())


def kind_of(source: Path) -> str:
    """Kind of a recording: file by name, folder by content. Raises LogError."""
    if not source.exists():
        raise LogError(f"{source}: no such file or folder")
    names = {path.name for path in source.iterdir()} if source.is_dir() else {source.name}
    if names & {"imu.csv", "imu.csv.gz"}:
        return "csv"
    if names & {"mav0", "imu0"}:
        return "euroc"
    if "metadata.yaml" in names or any(name.endswith(".mcap") for name in names):
        return ROSBAG
    kinds = {kind for name in names if (kind := kind_of_name(name))}
    if kinds == {ROSBAG} or (source.is_file() and kinds):
        return kinds.pop()
    raise LogError(f"{source}: its kind does not show; name it first: {', '.join(KINDS)}, {ROSBAG}")


def read(kind: str, source: Path, options: ImportOptions = DEFAULTS, progress: Progress | None = None) -> Recording:
    """Contents of a log of that kind (KINDS). Raises LogError."""
    if kind not in KINDS:
        raise LogError(f"no importer called {kind}; there are {', '.join(KINDS)}")
    if not source.exists():
        raise LogError(f"{source}: no such file or folder")
    _refuse_foreign(source, kind)
    importer: Callable[[Path, ImportOptions, Progress | None], Recording] = import_module(f"logs.importers.{KINDS[kind]}").read
    with refusing(LogError, source):
        return importer(source, options, progress)


def convert(
    kind: str, source: Path, out: Path, progress: Progress | None = None, options: ImportOptions = DEFAULTS
) -> ImportSummary:
    """Write the log to `out`, and its configuration (.toml). Raises LogError."""
    if out.exists() and source.exists() and out.samefile(source):
        raise LogError(f"{out}: the output would overwrite the input; name another file after -o")
    if kind == ROSBAG:
        options.refuse_but(kind, "imu")
        _refuse_foreign(source, kind)
        copy: Callable[..., ImportSummary] = import_module("logs.importers.rosbag.convert").convert
        with refusing(LogError, source, OSError):
            return copy(source, out, progress, options.imu)
    recording = read(kind, source, options, None if progress is None else lambda done: progress(_READING * done))
    counts: dict[str, int] = {}
    start_ns = end_ns = None
    watch = Watch(recording.settings.origin)
    with Recorder(out, metadata={"imported_from": source.name, "import_kind": kind}) as recorder:
        if recording.reference:  # an attachment, so that a replay hands it on
            recorder.attach(REFERENCE_ATTACHMENT, "text/plain", recording.reference.encode())
        for k, ((topic, schema, data), arrived_ns) in enumerate(_encoded(recording, source, watch), 1):
            recorder.write(topic, schema, data, arrived_ns)
            counts[topic] = counts.get(topic, 0) + 1
            start_ns = arrived_ns if start_ns is None else start_ns
            end_ns = arrived_ns
            if progress and k % _PROGRESS_EVERY == 0:
                progress(_READING + (1.0 - _READING) * k / len(recording))
    findings, notes = tuple(watch.findings()), recording.notes
    left_out = {ATTITUDE_TOPIC} & set(counts) if any(f.who == SENSORS["magnetometer"].topic for f in findings) else set()
    if left_out:
        notes = (*notes, "the autopilot's attitude is not taken to begin with: its heading rests on the magnetometer")
    config = out.with_suffix(".toml")
    try:
        config.write_text(recording.settings.toml(kind, source, tuple(t for t in counts if t not in left_out)))
    except OSError as error:
        raise LogError(f"{config}: cannot be written ({error.strerror})") from None
    if progress:
        progress(1.0)
    return ImportSummary(str(out), str(config), counts, start_ns or 0, end_ns or 0, notes, findings=findings)


def _refuse_foreign(source: Path, kind: str) -> None:
    """Raises LogError for a file that is no log of that kind, as its first bytes show."""
    if not source.is_file():
        return
    with refusing(LogError, source), opened(source) as file:
        head = file.read(foreign.HEAD_BYTES)
    if (what := foreign.foreign(head)) and source.suffix != ".gz":
        raise LogError(f"{source.name}: {what}")
    if (other := foreign.kind_of(head)) and other != kind:
        raise LogError(f"{source.name}: a log of another kind: landfix import {other}")


def _encoded(recording: Recording, source: Path, watch: Watch) -> Iterator[tuple[Encoded, int]]:
    with refusing(LogError, source):
        for message in recording:
            if not isinstance(message, Truth):
                watch.add(message)
            yield encode(message), message.arrived_ns


def encode(message: Message) -> Encoded:
    if isinstance(message, Truth):
        return encode_truth(message.t_ns, message.p_n, message.v_n, message.q_nb_wxyz)
    return encode_input(message)
