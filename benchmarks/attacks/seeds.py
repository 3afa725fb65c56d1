"""Small real files of each format, that benchmarks.attacks.damaged changes; logs of LANDFIX_DATA, cut, where that is there."""

import gzip
import json
import os
import struct
import tempfile
from pathlib import Path

import cv2
import numpy as np

from logs.store.recorder import Recorder
from logs.wire.encoding import encode_input
from models.messages import GnssFix, ImuSample

_CUT = 25_000  # bytes of a log
_ULOG_TOPICS = (b"sensor_combined", b"vehicle_gps_position", b"sensor_gps", b"vehicle_air_data", b"vehicle_attitude")
_ULOG_MESSAGES = 60  # of each of them
_NATIVE = {
    "ulog": ("px4_fmuv6c_6s.ulg", "px4_sitl_v115_31s.ulg"),
    "dataflash": ("ardupilot_log171.bin",),
    "tlog": ("ardupilot_flight.tlog",),
}
_RING = [[8.5, 47.4], [8.5002, 47.4], [8.5002, 47.4001], [8.5, 47.4001], [8.5, 47.4]]


def of(name: str) -> list[bytes]:
    """The seeds of a format of damaged; none where its data are absent."""
    match name:
        case "ulog" | "dataflash" | "tlog":
            folder = Path(os.environ.get("LANDFIX_DATA", "../shared/data")) / "native_logs"
            there = [(folder / file).read_bytes() for file in _NATIVE[name] if (folder / file).is_file()]
            return [_thinned(log) if name == "ulog" else log[:_CUT] for log in there]
        case "csv":
            return [_csv()]
        case "csv.gz":
            return [gzip.compress(_csv(), mtime=0)]
        case "mcap":
            return [_log()]
        case "bag":
            return [_bag(b"none"), _bag(b"none", index=7)]
        case "map" | "extract":
            return [json.dumps({"type": "FeatureCollection", "features": [_feature(k) for k in range(4)]}).encode()]
        case "overpass":
            return [_overpass()]
        case "geotiff":
            return [_geotiff("<"), _geotiff(">")]
        case "route":
            return [
                b'<gpx><trk><trkseg><trkpt lat="47.4" lon="8.5"/><trkpt lat="47.5" lon="8.6"/></trkseg></trk></gpx>',
                b"47.4,8.5\n47.5,8.6\n",
            ]
        case _:
            return [
                b'[imu]\naxes = "frd"\ngyro_noise = 1e-3\n[map]\norigin = [47.4, 8.5, 400.0]\n[inputs]\ngnss = ["/a", "/b"]\n'
            ]


def _csv() -> bytes:
    rows = [f"{k * 0.005:.3f},0.01,{0.001 * k:.4f},0.0,0.1,0.0,-9.81" for k in range(400)]
    return "\n".join(["t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2", *rows]).encode()


def _log() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "seed.mcap"
        with Recorder(path) as recorder:
            for k in range(300):
                t_ns = 1_795_000_000_000_000_000 + 5_000_000 * k
                recorder.write(*encode_input(ImuSample(t_ns, t_ns, (0.0, 0.0, 0.001 * k), (0.0, 0.0, -9.8))), t_ns)
                if k % 40 == 0:
                    fix = GnssFix(t_ns, t_ns, 47.4, 8.5, 400.0, np.eye(3), 0)
                    recorder.write(*encode_input(fix), t_ns)
        return path.read_bytes()


def _thinned(log: bytes) -> bytes:
    """A ULog with the definitions and the first messages of the topics that an import needs."""
    kept, count, at, wanted = bytearray(log[:16]), dict[int, int](), 16, set[int]()
    while at + 3 <= len(log):
        size, kind = struct.unpack_from("<Hc", log, at)
        record = log[at : at + 3 + size]
        body, at = record[3:], at + 3 + size
        if kind == b"A" and body[3:] in _ULOG_TOPICS:
            wanted.add(int.from_bytes(body[1:3], "little"))
        if kind == b"D":
            number = int.from_bytes(body[:2], "little")
            count[number] = count.get(number, 0) + 1
            keep = number in wanted and count[number] <= _ULOG_MESSAGES
        else:
            keep = kind == b"B" or (kind == b"F" and body.startswith(_ULOG_TOPICS)) or (kind == b"A" and body[3:] in _ULOG_TOPICS)
        if keep:
            kept += record
    return bytes(kept)


def _geotiff(order: str) -> bytes:
    """Uncompressed, 0.5 m a pixel, in UTM zone 32."""
    wide, high = 60, 40
    pixels = np.random.default_rng(1).bytes(3 * wide * high)
    at = 8 + len(pixels)
    keys = (1, 1, 0, 2, 1025, 0, 1, 1, 3072, 0, 1, 32632)
    extra = struct.pack(f"{order}9d15H", 0.5, 0.5, 0.0, 0.0, 0.0, 0.0, 465_000.0, 5_250_000.0, 0.0, *keys, 8, 8, 8)
    entries = (
        (256, 4, 1, wide), (257, 4, 1, high), (258, 3, 3, at + 96), (262, 4, 1, 2), (273, 4, 1, 8), (277, 4, 1, 3),
        (278, 4, 1, high), (279, 4, 1, len(pixels)), (33550, 12, 3, at), (33922, 12, 6, at + 24), (34735, 3, 12, at + 72),
    )  # fmt: skip
    directory = struct.pack(f"{order}H", len(entries)) + b"".join(struct.pack(f"{order}HHII", *e) for e in entries)
    head = {"<": b"II*\0", ">": b"MM\0*"}[order] + struct.pack(f"{order}I", at + len(extra))
    return head + pixels + extra + directory + bytes(4)


def _record(data: bytes, **fields: bytes) -> bytes:
    header = b"".join(len(f).to_bytes(4, "little") + f for f in (n.encode() + b"=" + v for n, v in fields.items()))
    return len(header).to_bytes(4, "little") + header + len(data).to_bytes(4, "little") + data


def _bag(compression: bytes, index: int = 0) -> bytes:
    """A ROS 1 bag as a recorder that was killed leaves it."""
    about = _record(b"", type=b"sensor_msgs/Imu", md5sum=b"*", message_definition=b"")[4:-4]
    content = _record(about, op=b"\x07", conn=bytes(4), topic=b"/imu")
    for k in range(60):
        stamp = (1_700_000_000).to_bytes(4, "little") + (5_000_000 * k).to_bytes(4, "little")
        body = k.to_bytes(4, "little") + stamp + bytes(4) + bytes(8 * 27) + struct.pack("<d", 9.8) + bytes(72)
        content += _record(body, op=b"\x02", conn=bytes(4), time=stamp)
    chunk = _record(content, op=b"\x05", compression=compression, size=len(content).to_bytes(4, "little"))
    start = _record(
        b" " * 100, op=b"\x03", index_pos=index.to_bytes(8, "little"), conn_count=b"\1\0\0\0", chunk_count=b"\1\0\0\0"
    )
    return b"#ROSBAG V2.0\n" + start + chunk


def _feature(k: int) -> dict[str, object]:
    ring = [[x + 0.001 * k, y] for x, y in _RING]
    geometry = {"type": "Polygon", "coordinates": [ring]} if k % 2 else {"type": "MultiPolygon", "coordinates": [[ring]]}
    properties = {"building": "yes", "height_m": 6.5, "colour": "#803020", "name": f"h{k}"}
    return {"type": "Feature", "id": f"way/{k}", "geometry": geometry, "properties": properties}


def _overpass() -> bytes:
    nodes = [{"type": "node", "id": k, "lon": x, "lat": y} for k, (x, y) in enumerate(_RING[:4])]
    way = {"type": "way", "id": 9, "nodes": [0, 1, 2, 3, 0], "tags": {"building": "yes"}}
    halves = [{"type": "way", "ref": k, "role": "outer", "geometry": [{"lon": x, "lat": y} for x, y in part]}
              for k, part in enumerate((_RING[:3], _RING[2:]))]  # fmt: skip
    relation = {"type": "relation", "id": 5, "members": halves, "tags": {"building": "yes"}}
    return json.dumps({"elements": [*nodes, way, relation]}).encode()


def image(ending: str) -> bytes:
    """A small one of that format."""
    image = np.random.default_rng(1).integers(0, 255, (40, 60, 3), dtype=np.uint8)
    _, data = cv2.imencode(ending, image)
    return data.tobytes()
