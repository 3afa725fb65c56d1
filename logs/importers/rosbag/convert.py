"""A bag to a log under its own topics, and its configuration.

Missing stamps, or those of another clock, become recording times.
"""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Final

from logs.findings import Watch
from logs.importers.rosbag.bag import Bag
from logs.importers.rosbag.choose import Choice, choose
from logs.importers.rosbag.survey import STAMPED, TWIST_STAMPED, Survey, stamped, survey
from logs.importers.settings import Settings
from logs.importers.summary import ImportSummary
from logs.store.reader import LogError, Record, check_output
from logs.store.recorder import Recorder
from logs.wire import schemas
from logs.wire.codec import Decoder, ImuMounting, Topics
from logs.wire.receiver import ReceiverFlags
from models.messages import GnssFix, ReceiverState

_CLOCKS_NS: Final = 1_000_000_000  # stamps that differ from those of the IMU by more are of another clock
_NO_COVARIANCE: Final = bytes(8 * 36)  # what a TwistStamped lacks to be a TwistWithCovarianceStamped
_READING: Final = 0.4  # the first pass's share of the work
_EVERY: Final = 500  # messages between reports


def convert(source: Path, out: Path, progress: Callable[[float], None] | None = None, imu: str = "") -> ImportSummary:
    """Write the log and OUT.toml; imu: topic. Raises LogError."""
    check_output(out, source)
    if not source.exists():
        raise LogError(f"{source}: no such file or folder")
    bag, report = Bag(source), progress or (lambda _: None)
    found = survey(_reported(bag, None, lambda f: report(_READING * f)))
    unknown = {t.name: t.schema for t in bag.topics.values() if not t.readable}
    try:
        choice = choose(found, unknown, imu)
    except LogError as error:
        raise LogError("; ".join([f"{source}: {error}", *bag.notes])) from None
    notes = [*bag.notes, *choice.notes]
    shift_ns, restamp = _clocks(choice, found, notes)
    flags, flagged = ReceiverFlags(choice.inputs.get("gnss", ())), 0
    wanted = frozenset(row.topic for row in choice.rows if row.copied) | flags.topics.keys()
    counts: dict[str, int] = {}
    mounting = ImuMounting("frd" if choice.axes == "frd" else "flu", *choice.mounting_deg)
    decoder, watch = Decoder(Topics.of(choice.inputs), mounting), Watch()
    start_ns = end_ns = 0
    with Recorder(out, metadata={"imported_from": source.name, "import_kind": "rosbag"}) as recorder:
        for record in _reported(bag, wanted, lambda f: report(_READING + (1.0 - _READING) * f)):
            end_ns = record.log_time_ns + shift_ns
            if record.topic in flags.topics:
                flags.hear(record.topic, record.data, end_ns)
                continue
            start_ns = start_ns or end_ns
            topic, schema, data = _message(record, end_ns if record.topic in restamp else None)
            data = flags.marked(topic, data, end_ns)
            recorder.write(topic, schema, data, end_ns)
            if (message := decoder.decode(topic, schema, data, end_ns)) is not None:
                watch.add(message)
                flagged += isinstance(message, GnssFix) and message.state is not ReceiverState.UNKNOWN
            counts[record.topic] = counts.get(record.topic, 0) + 1
    if flagged:
        notes.append(f"the receiver reports jamming or spoofing in {flagged} fixes")
    config = out.with_suffix(".toml")
    try:
        config.write_text(Settings().text("rosbag", source, choice.inputs, choice.offered, choice.axes, choice.mounting_deg))
    except OSError as error:
        raise LogError(f"{config}: cannot be written ({error.strerror})") from None
    report(1.0)
    rows, findings = tuple(choice.rows), tuple(watch.findings())
    return ImportSummary(str(out), str(config), counts, start_ns, end_ns, tuple(notes), rows, findings)


def _reported(bag: Bag, wanted: frozenset[str] | None, report: Callable[[float], None]) -> Iterator[Record]:
    for k, record in enumerate(bag.messages(wanted)):
        if k % _EVERY == 0:
            report(bag.fraction)
        yield record


def _message(record: Record, t_ns: int | None) -> tuple[str, str, bytes]:
    data = record.data if t_ns is None else stamped(record.data, t_ns)
    if record.schema == TWIST_STAMPED:
        return record.topic, schemas.TWIST, data + _NO_COVARIANCE
    return record.topic, record.schema, data


def _clocks(choice: Choice, found: Mapping[str, Survey], notes: list[str]) -> tuple[int, frozenset[str]]:
    (imu,) = choice.inputs["imu"]
    ahead_ns = 0 if found[imu].unstamped else found[imu].ahead_ns
    shift_ns = ahead_ns if abs(ahead_ns) > _CLOCKS_NS else 0
    if shift_ns:
        notes.append(f"stamps of {imu} are {abs(1e-9 * shift_ns):.1f} s off the times of recording, which are shifted to them")
    restamp = set()
    for row in choice.rows:
        s = found.get(row.topic)
        if s is None or not row.copied or row.type not in STAMPED or not s.t_ns:
            continue
        if s.unstamped:
            notes.append(f"{row.topic}: has no stamps; the times of recording are taken")
        elif abs(s.ahead_ns - shift_ns) > _CLOCKS_NS:
            notes.append(f"{row.topic}: its stamps are of another clock than those of {imu}; the times of recording are taken")
        else:
            continue
        restamp.add(row.topic)
    return shift_ns, frozenset(restamp)
