"""Files that nobody should write, and the commands that read them."""

import gzip
import json
import lzma
import os
import struct
import tarfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from benchmarks.attacks import seeds
from benchmarks.attacks.cell import ANY, READ_OR_REFUSED, REFUSED, Cell
from benchmarks.attacks.typed import LOG
from calib.files.formats import save_rig
from logs.store.reader import LogReader
from logs.store.recorder import Recorder
from vision.synthetic.rigs import make_rig

_PLACE: Final = "47.4,8.5"
_PRIOR: Final = "47.4,8.5,560,0,0,90"
_HIGH: Final = ("--picture-height-m", "455")
_READ_BY: Final[dict[str, tuple[str, ...]]] = {  # "@": the file
    "replay": ("replay", "@", "-o", "out.mcap"),
    "evaluate": ("evaluate", "@"),
    "report": ("report", "@", "-o", "out.html"),
    "export": ("export", "@", "-o", "out.csv"),
    "doctor": ("doctor", "@"),
    "recover": ("recover", "@", "-o", "saved.mcap"),
    "overlay": ("overlay", "@", "-o", "out.mp4"),
    "tune": ("tune", "@", "-o", "tuned.toml", "--jobs", "1", "--coarse", "1", "--fine", "1"),
}


def prepare(folder: Path) -> None:
    """What sound commands need besides the hostile file."""
    save_rig(folder / "rig.yaml", make_rig())
    (folder / "map.geojson").write_bytes(seeds.of("map")[0])
    (folder / LOG).write_bytes(seeds.of("mcap")[0])


def logs(folder: Path, cases: Path) -> Iterator[Cell]:
    """For every command that reads a log. cases: shared inputs, left out where they are absent."""
    attacks = cases / "attacks"
    log = seeds.of("mcap")[0]
    rng = np.random.default_rng(1)
    noise = rng.bytes(10_000)
    broken = {"empty": b"", "one byte": b"\x89", "noise": noise, "magic only": log[:8], "text": b"t_s,gx\n1,2\n" * 100}
    _named(folder / LOG, folder / "names.mcap")
    damaged = {"torn": log[: len(log) // 2], "noise within": log[:3000] + noise[:2000] + log[5000:], "tail only": log[-3000:]}
    for name, data in (broken | damaged).items():
        (folder / f"{name}.mcap").write_bytes(data)
    (folder / "loop.mcap").symlink_to(folder / "loop.mcap")
    (folder / "folder.mcap").mkdir()
    os.mkfifo(folder / "pipe.mcap")
    for what, words in _READ_BY.items():
        for name in broken:
            codes = READ_OR_REFUSED if (what, name) == ("recover", "magic only") else REFUSED  # a log of no message
            yield Cell("log", f"{what}: {name}", _words(words, folder / f"{name}.mcap"), codes)
        for name in (*damaged, "names"):
            yield Cell("log", f"{what}: {name}", _words(words, folder / f"{name}.mcap"), READ_OR_REFUSED)
        for name in ("loop", "folder", "pipe", "absent"):
            yield Cell("log", f"{what}: {name}", _words(words, folder / f"{name}.mcap"), REFUSED | frozenset({2}))
        for bomb in _there(attacks, "zstd_250MiB_x40.mcap", "huge_message_count.mcap", "../bomb_zstd.mcap"):
            yield Cell("log", f"{what}: {bomb.name}", _words(words, bomb), REFUSED)
    for bomb in _there(attacks, "zstd_250MiB_x40.mcap", "huge_message_count.mcap"):
        yield Cell("log", f"import rosbag: {bomb.name}", ("import", "rosbag", str(bomb), "-o", "i.mcap"), REFUSED)
    yield Cell("log", "import rosbag: names", ("import", "rosbag", "names.mcap", "-o", "i.mcap"), READ_OR_REFUSED)
    yield Cell("log", "a log over itself", ("replay", "torn.mcap", "-o", "torn.mcap"), REFUSED | frozenset({2}))


def importers(folder: Path, cases: Path) -> Iterator[Cell]:
    """Logs of others."""
    noise = np.random.default_rng(2).bytes(5000)
    head = b"t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2\n"
    tables = {
        "empty": b"", "header only": head, "noise": noise, "one row": head + b"0,0,0,0,0,0,-9.8\n", "nul": bytes(5000),
        "words": head + b"a,b,c,d,e,f,g\n" * 50, "nan": head + b"nan,nan,nan,nan,nan,nan,nan\n" * 50,
        "huge": head + b"1e308,1e308,-1e308,1e999,0,0,0\n" * 50, "one long line": b"," * 3_000_000,
        "one long number": head + b"9" * 2_000_000 + b",0,0,0,0,0,0\n", "columns twice": head[:-1] + b"," + head + b"0," * 13,
        "quotes": head + b'"' * 100_001, "time back": head + b"".join(b"%d,0,0,0,0,0,-9.8\n" % (50 - k) for k in range(50)),
    }  # fmt: skip
    for name, data in tables.items():
        path = folder / f"csv {name}"
        path.mkdir()
        (path / "imu.csv").write_bytes(data)
        codes = READ_OR_REFUSED if name == "time back" else REFUSED
        yield Cell("import", f"csv: {name}", ("import", "csv", str(path), "-o", "i.mcap"), codes)
    bomb = folder / "csv bomb"
    bomb.mkdir()
    (bomb / "imu.csv.gz").write_bytes(_bomb())
    yield Cell("import", "csv: gzip of 2 GiB", ("import", "csv", str(bomb), "-o", "i.mcap"), REFUSED)
    yield from _packed(folder, cases / "turn3")
    for kind, ending in (("ulog", "ulg"), ("dataflash", "bin"), ("tlog", "tlog"), ("rosbag", "bag")):
        for name, data in {"empty": b"", "noise": noise, "nul": bytes(5000), "ones": b"\xff" * 5000}.items():
            path = folder / f"{name}.{ending}"
            path.write_bytes(data)
            yield Cell("import", f"{kind}: {name}", ("import", kind, str(path), "-o", "i.mcap"), REFUSED)
        for k, seed in enumerate(seeds.of("bag" if kind == "rosbag" else kind)):
            (folder / f"half{k}.{ending}").write_bytes(seed[: len(seed) // 2] + noise)
            words = ("import", kind, str(folder / f"half{k}.{ending}"), "-o", "i.mcap")
            yield Cell("import", f"{kind}: half {k}, then noise", words, READ_OR_REFUSED)
    for path in _there(cases / "attacks", "imp_0_ulog.ulg", "imp_1_ulog.ulg", "imp_3_ulog.ulg", "imp_2_dataflash.bin"):
        kind = "ulog" if path.suffix == ".ulg" else "dataflash"
        yield Cell("import", f"{kind}: {path.name}", ("import", kind, str(path), "-o", "i.mcap"), REFUSED)


def _packed(folder: Path, turn3: Path) -> Iterator[Cell]:
    """Logs with unusual stamps, and a bag that a recorder left when it was killed."""
    for path in _there(turn3, "csv_cout6.tar.xz", "csv_float32.tar.xz"):
        with tarfile.open(path) as archive:
            archive.extractall(folder / path.stem, filter="data")
        (where,) = {table.parent for table in (folder / path.stem).rglob("imu.csv")}
        yield Cell("import", f"csv: {path.name}", ("import", "csv", str(where), "-o", "i.mcap"), REFUSED)
    for path in _there(turn3, "ros1_killed.bag.active.xz"):
        (folder / path.stem).write_bytes(lzma.decompress(path.read_bytes()))
        yield Cell(
            "import", f"rosbag: {path.stem}", ("import", "rosbag", str(folder / path.stem), "-o", "i.mcap"), frozenset({0})
        )


def maps(folder: Path, cases: Path) -> Iterator[Cell]:
    """Maps, and extracts to make them of."""
    attacks = cases / "attacks"
    feature = json.loads(seeds.of("map")[0])["features"][0]
    ring = [[8.5, 47.4], [8.5001, 47.4], [8.5001, 47.4001]]
    files = {
        "empty": b"", "noise": np.random.default_rng(3).bytes(3000), "deep": b"[" * 200_000, "deep objects": b'{"a":' * 100_000,
        "a number": b"7", "nul": bytes(3000), "not utf-8": b'{"type":"FeatureCollection","features":["\xff\xfe"]}',
        "long number": b'{"type":"FeatureCollection","features":[' + b"9" * 1_000_000 + b"]}",
        "infinite": _collection({**feature, "geometry": {"type": "Polygon", "coordinates": [[[1e999, 1], *ring]]}}),
        "nan": _collection({**feature, "geometry": {"type": "Polygon", "coordinates": [[[float("nan"), 1], *ring]]}}),
        "words for numbers": _collection({**feature, "geometry": {"type": "Polygon", "coordinates": [[["a", "b"], *ring]]}}),
        "a million corners": _collection({**feature, "geometry": {"type": "Polygon", "coordinates": [ring * 300_000]}}),
        "escapes": _collection({**feature, "id": "\x1b]0;mine\x07\x1b[2J", "geometry": {"type": "Dot"}}),
        "latitude 1e6": _collection({**feature, "geometry": {"type": "Polygon", "coordinates": [[[x, 1e6] for x, _ in ring]]}}),
    }  # fmt: skip
    for name, data in files.items():
        path = folder / f"map {name}.geojson"
        path.write_bytes(data)
        yield Cell("map", f"check: {name}", ("map", "check", str(path)), ANY if name == "a million corners" else REFUSED)
        yield Cell("map", f"get: {name}", ("map", "get", _PLACE, "--source", str(path), "-o", "m.geojson"), READ_OR_REFUSED)
    (folder / "bomb.geojson.gz").write_bytes(_bomb())
    hostile = _there(
        attacks, "over_idlist.json", "over_memb.json", "over_noid.json", "crs_list.geojson", "vrt.gpkg", "tiff_tagcount.tif"
    )
    for path in (folder / "bomb.geojson.gz", *hostile):
        yield Cell("map", f"get: {path.name}", ("map", "get", _PLACE, "--source", str(path), "-o", "m.geojson"), REFUSED)
    for path in _there(attacks, "tiff_tagcount.tif"):
        words = ("map", "get", _PLACE, "--source", "map.geojson", "--terrain", str(path), "-o", "m.geojson")
        yield Cell("map", f"terrain: {path.name}", words, REFUSED)
    (folder / "ways.json").write_bytes(_halves(20_000))
    yield Cell(
        "map", "get: 20,000 open halves", ("map", "get", _PLACE, "--source", "ways.json", "-o", "m.geojson"), READ_OR_REFUSED
    )


def images(folder: Path, cases: Path) -> Iterator[Cell]:
    """Camera images and orthophotos."""
    attacks = cases / "attacks"
    jpeg, png = (seeds.image(ending) for ending in (".jpg", ".png"))
    big = b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", struct.pack(">IIBBBBB", 2**31 - 1, 2**31 - 1, 8, 2, 0, 0, 0))
    files = {
        "empty.jpg": b"", "noise.jpg": np.random.default_rng(4).bytes(3000), "text.png": b"an image\n", "torn.jpg": jpeg[:200],
        "torn.png": png[:100], "gif.png": b"GIF89a" + bytes(100), "2^31.png": big + _chunk(b"IDAT", zlib.compress(bytes(1000))),
        "zero.png": b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", bytes(13)), "xml.jpg": b'<svg width="9e9" height="9e9"/>',
        "scans.jpg": _scans(100_000),
        "pnm.ppm": b"P6 999999999 999999999 255\n", "bmp.bmp": b"BM" + bytes(12) + struct.pack("<Iii", 40, 2**31 - 1, -(2**31)),
    }  # fmt: skip
    for name, data in files.items():
        (folder / name).write_bytes(data)
    paths = [folder / name for name in files]
    paths += _there(attacks, "jpeg_30000_header.jpg", "png_32000_1bit.png", "tiff_tagcount.tif")
    for path in paths:
        located = ("locate", str(path), "--rig", "rig.yaml", "--map", "map.geojson", "--prior", _PRIOR)
        yield Cell("image", f"locate: {path.name}", located, REFUSED)
        yield Cell("image", f"photo: {path.name}", ("locate", str(path), "--map", "map.geojson"), REFUSED)
        yield Cell("image", f"measure: {path.name}", ("measure", str(path), str(path), "--rig", "rig.yaml"), REFUSED)
        words = ("locate", "torn.jpg", "--rig", "rig.yaml", "--picture", str(path), *_HIGH, "--prior", _PRIOR)
        yield Cell("image", f"orthophoto: {path.name}", words, REFUSED)

    for name, text in {"long": "x: [" + "1," * 400_000 + "1]\n", "deep": "x: " + "[" * 400_000, "alike": _aliases(9)}.items():
        (folder / f"{name}.yaml").write_text(text)
        yield Cell("image", f"rig: {name}", ("measure", "torn.jpg", "torn.jpg", "--rig", f"{name}.yaml"), REFUSED)


def _there(folder: Path, *names: str) -> list[Path]:
    return [folder / name for name in names if (folder / name).is_file()]


def _words(words: tuple[str, ...], path: Path) -> tuple[str, ...]:
    return tuple(str(path) if word == "@" else word for word in words)


def _collection(*features: object) -> bytes:
    return json.dumps({"type": "FeatureCollection", "features": features}).encode()


def _named(log: Path, out: Path) -> None:
    """The log, its topics named with control characters and markup."""
    with LogReader(log) as reader, Recorder(out) as recorder:
        for record in reader:
            recorder.write(f"{record.topic}\x1b]0;mine\x07[/x]", record.schema, record.data, record.log_time_ns)


def _scans(count: int) -> bytes:
    """A progressive JPEG whose last scan comes again and again."""
    image = np.random.default_rng(1).integers(0, 255, (480, 640), dtype=np.uint8)
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_QUALITY, 1])[1].tobytes()
    scans = data.split(b"\xff\xda")
    return data[:-2] + (b"\xff\xda" + min(scans[1:], key=len)) * count + data[-2:]


def _aliases(levels: int) -> str:
    """YAML of ten to the power of so many numbers, by aliases."""
    lines = [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}' if k else '1'] * 10)}]" for k in range(levels)]
    return "\n".join([*lines, "camera_matrix: *a0\n"])


def _bomb() -> bytes:
    """2 GiB of zeros, in members of one MiB."""
    return gzip.compress(bytes(2**20)) * 2048


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _halves(count: int) -> bytes:
    """An Overpass relation of as many ways, of which no two meet."""
    ways = [{"type": "way", "ref": k, "role": "outer", "geometry": [{"lon": 8.5 + 1e-6 * k, "lat": y} for y in (47.4, 47.41)]}
            for k in range(count)]  # fmt: skip
    return json.dumps({"elements": [{"type": "relation", "id": 1, "members": ways, "tags": {"building": "yes"}}]}).encode()
