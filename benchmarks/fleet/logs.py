"""Logs of a fleet: windows of recorded flights, each with draws of its own for what perturbs it.

    p' = p + n,  n ~ N(0, (0.1 m)^2)        each fix
    w' = w + b,  b ~ N(0, (1 mrad/s)^2)     the gyroscope, once a log

No fix comes in _OUTAGE_S; of every tenth log all fixes come _LATE_NS late; every twentieth holds stereo images.
"""

from collections.abc import Iterator
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from benchmarks.flights.tasks import Task, data_folder, flights, make, thinned
from logs.store.reader import LogReader, Record
from logs.store.recorder import CONFIG_ATTACHMENT, Recorder
from logs.wire import schemas
from logs.wire.encoding import header_of, packed
from models.messages import Array

SECONDS: Final = 30.0
LATE: Final = 10  # of so many logs one has late fixes
WITH_IMAGES: Final = 20
_LATE_NS: Final = 300_000_000
_OUTAGE_S: Final = (18.0, 26.0)
_GROUPS: Final = {"euroc": 2, "tumvi": 2, "quad": 1}  # one of so many IMU samples: about 100 Hz
_FLIGHTS: Final = 3  # of a set
_TRUTHS_A_S: Final = 25
_IMAGES_A_S: Final = 4
_FIX_M, _GYRO_RAD_S = 0.1, 1e-3
Event = tuple[int, str, str, bytes]  # arrival, topic, type, CDR

_IMU_DOUBLES, _GYRO = 37, slice(13, 16)  # at the end of sensor_msgs/msg/Imu
_FIX_DOUBLES, _POSITION = 43, slice(0, 3)


def logs(folder: Path, count: int) -> Iterator[Path]:
    """`count` logs in `folder`; one that is there is left as it is."""
    bases = [base for group, every in _GROUPS.items() for base in _bases(group, every, folder / "tasks")]
    for k in range(count):
        out = folder / f"{k:05}.mcap"
        if not out.exists():
            _write(bases[k % len(bases)], k, out.with_suffix(".part"))
            out.with_suffix(".part").rename(out)
        yield out


def _bases(group: str, every: int, folder: Path) -> Iterator[Path]:
    """The recorded flights of a set with fixes twice a second."""
    for flight in flights(group)[:_FLIGHTS]:
        task = make(Task(group, flight, "N", 0), folder)
        if task is not None:
            yield thinned(task, every) if every > 1 else task


@cache
def _images() -> list[tuple[bytes, bytes]]:
    """Stereo pairs as JPEG."""
    source = data_folder() / "images" / "euroc_v101_static_stereo_imu"
    sides = [islice(sorted((source / camera).glob("*.png")), 10) for camera in ("cam0", "cam1")]
    return [(_jpeg(left), _jpeg(right)) for left, right in zip(*sides, strict=True)]


def _jpeg(path: Path) -> bytes:
    image = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise SystemExit(f"{path}: is no image")
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()


@cache
def _records(base: Path) -> list[Record]:
    """Those of a flight, the truth thinned."""
    with LogReader(base) as reader:
        kept, last = list[Record](), 0
        for record in reader:
            if record.topic != "/truth" or record.log_time_ns - last >= 1e9 / _TRUTHS_A_S:
                kept.append(record)
                last = record.log_time_ns if record.topic == "/truth" else last
    return kept


def _write(base: Path, k: int, out: Path) -> None:
    rng, records = np.random.default_rng(k), _records(base)
    first, last = records[0].log_time_ns, records[-1].log_time_ns
    start = first + int(rng.uniform(0.0, max(0.0, (last - first) * 1e-9 - SECONDS)) * 1e9)
    window = [r for r in records if start <= r.log_time_ns < start + SECONDS * 1e9]
    quiet = [start + int(s * 1e9) for s in _OUTAGE_S]
    events = _moved([r for r in window if r.topic == "/imu"], _IMU_DOUBLES, _GYRO, rng.normal(0.0, _GYRO_RAD_S, (1, 3)))
    fixes = [r for r in window if r.schema == schemas.POSE_FIX and not quiet[0] < r.log_time_ns < quiet[1]]
    late = _LATE_NS if k % LATE == 0 else 0
    events += _moved(fixes, _FIX_DOUBLES, _POSITION, rng.normal(0.0, _FIX_M, (len(fixes), 3)), late)
    events += [(r.log_time_ns, r.topic, r.schema, r.data) for r in window if r.topic == "/truth"]
    if k % WITH_IMAGES == 0:
        events += _pictures(start)
    with Recorder(out) as recorder:
        recorder.attach(CONFIG_ATTACHMENT, "application/toml", base.with_suffix(".toml").read_bytes())
        for log_time_ns, topic, schema, data in sorted(events, key=lambda e: (e[0], e[1] != "/pose_fix")):
            recorder.write(topic, schema, data, log_time_ns)


def _moved(records: list[Record], doubles: int, where: slice, by: Array, late_ns: int = 0) -> list[Event]:
    """The messages with `by` added to some of the doubles at their end."""
    ends = np.array([np.frombuffer(r.data[-8 * doubles :], "<f8") for r in records]).reshape(-1, doubles)
    ends[:, where] += by
    return [
        (r.log_time_ns + late_ns, r.topic, r.schema, r.data[: -8 * doubles] + end.tobytes())
        for r, end in zip(records, ends, strict=True)
    ]


def _pictures(start: int) -> Iterator[Event]:
    for n in range(int(SECONDS * _IMAGES_A_S)):
        t_ns = start + n * 1_000_000_000 // _IMAGES_A_S
        for topic, file in zip(("/left/image", "/right/image"), _images()[n % len(_images())], strict=True):
            header, data = header_of(t_ns, "camera"), np.frombuffer(file, np.uint8)
            yield t_ns, *packed(topic, schemas.COMPRESSED_IMAGE, header=header, format="jpeg", data=data)
