"""Bags of a simulated flight, written by rosbags in each storage, with the disturbances that real ones have."""

import struct
from collections.abc import Callable, Iterable
from pathlib import Path

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from logs.store.reader import Record
from logs.wire.codec import encode_input
from logs.wire.schemas import STORE, is_known
from models.sim.scenario import simulate
from models.sim.scenario_file import loads

SCENARIO = 'duration_s = 30.0\n[vehicle]\nkind = "multirotor"\n[imu]\nrate_hz = 100.0\n[gnss]\n'
NAMES = {"/imu": "/mavros/imu/data_raw", "/gnss": "/gps/fix", "/gnss/velocity": "/gps/velocity"}
ROS1 = get_typestore(Stores.ROS1_NOETIC)


def flight() -> list[Record]:
    """IMU and receiver under the names of a ROS driver, in the order of arrival."""
    messages = simulate(loads(SCENARIO), seed=1).messages
    encoded = ((encode_input(m), m.arrived_ns) for m in messages)
    return [Record(NAMES[e.topic], e.schema, t_ns, e.data) for e, t_ns in encoded if e.topic in NAMES]


def changed(records: Iterable[Record], topic: str, change: Callable[[Record], Record]) -> list[Record]:
    """The messages of a topic changed."""
    return [change(r) if r.topic == topic else r for r in records]


def ros2(path: Path, records: Iterable[Record], storage: StoragePlugin, foreign: Typestore = STORE) -> Path:
    """A folder with metadata.yaml and one file; foreign: knows types that STORE does not."""
    with Writer2(path, version=9, storage_plugin=storage) as writer:
        connections = {}
        for r in records:
            if r.topic not in connections:
                store = STORE if is_known(r.schema) else foreign
                connections[r.topic] = writer.add_connection(r.topic, r.schema, typestore=store)
            writer.write(connections[r.topic], r.log_time_ns, r.data)
    return path


def ros1(
    path: Path, records: Iterable[Record], compression: Writer1.CompressionFormat | None = None, foreign: Typestore = ROS1
) -> Path:
    """A file of ROS 1; foreign: as of ros2."""
    writer = Writer1(path)
    if compression:
        writer.set_compression(compression)
    with writer:
        connections = {}
        for r in records:
            if r.topic not in connections:
                store = ROS1 if is_known(r.schema) else foreign
                connections[r.topic] = writer.add_connection(r.topic, r.schema, typestore=store)
            raw = (STORE if is_known(r.schema) else foreign).cdr_to_ros1(r.data, r.schema)
            writer.write(connections[r.topic], r.log_time_ns, raw)
    return path


def without_index(path: Path, cut: float) -> Path:
    """As a recorder that was killed leaves it: no place of the index in the first record, and a torn end."""
    data = bytearray(path.read_bytes()[: int(cut * path.stat().st_size)])
    at = data.index(b"index_pos=") + len(b"index_pos=")
    data[at : at + 8] = struct.pack("<Q", 0)
    path.write_bytes(bytes(data))
    return path
