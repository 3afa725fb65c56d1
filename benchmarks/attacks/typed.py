"""Configurations and arguments that nobody should type."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from benchmarks.attacks.cell import ANY, READ_OR_REFUSED, REFUSED, USAGE, Cell

_CONFIGURATIONS: Final[dict[str, bytes]] = {
    "not utf-8": b"[imu]\naxes = '\xff'\n",
    "nul": b"[imu]\n\0\n",
    "noise": bytes(range(128, 256)) * 100,
    "a directory": b"",
    "no key": b"= 1\n",
    "half a table": b"[imu\n",
    "twice": b"[imu]\n[imu]\n",
    "unknown table": b"[imuu]\na = 1\n",
    "unknown key": b"[imu]\naxis = 'flu'\n",
    "deep list": b"a = " + b"[" * 100_000,
    "deep keys": b"a." * 50_000 + b"b = 1\n",
    "deep tables": b"a = " + b"{a=" * 50_000,
    "many tables": b"".join(b"[t%d]\n" % k for k in range(100_000)),
    "long key": b"a" * 5_000_000 + b" = 1\n",
    "long string": b"a = '" + b"x" * 5_000_000,
    "long number": b"a = " + b"9" * 1_000_000,
    "long exponent": b"[imu]\ngyro_noise = 1e999999999\n",
    "nan": b"[imu]\ngyro_noise = nan\n",
    "inf": b"[imu]\ngyro_noise = inf\n",
    "negative": b"[imu]\ngyro_noise = -1.0\n",
    "a word for a number": b"[imu]\ngyro_noise = 'low'\n",
    "a list for a word": b"[imu]\naxes = ['flu']\n",
    "a date": b"[imu]\naxes = 2026-11-28\n",
    "a latitude of 100": b"[map]\norigin = [100.0, 8.5, 0.0]\n",
    "two numbers of three": b"[map]\norigin = [47.4, 8.5]\n",
    "nan origin": b"[map]\norigin = [nan, 8.5, 0.0]\n",
    "wildcard input": b"[inputs]\ngnss = '/a/*'\n",
    "all topics": b"[inputs]\ngnss = '**'\n",
    "own output": b"[inputs]\npose_fix = '/landfix/pose'\n",
    "own odometry": b"[inputs]\nodometry = '/landfix/odometry'\n",
    "own global": b"[inputs]\ngnss = '/landfix/global'\n",
    "own smoothed": b"[inputs]\npose_fix = '/landfix/smoothed'\n",
    "truth": b"[inputs]\nodometry = '/truth'\n",
    "one topic for two": b"[inputs]\ngnss = '/a'\npose_fix = '/a'\n",
    "empty topic": b"[inputs]\ngnss = ''\n",
    "topic with a nul": b'[inputs]\ngnss = "/a\\u0000"\n',
    "topic with an escape": b'[inputs]\ngnss = "/a\\u001b[2J"\n',
    "topic of 10^6 letters": b"[inputs]\ngnss = '/" + b"a" * 1_000_000 + b"'\n",
    "100,000 topics": b"[inputs]\ngnss = [" + b",".join(b"'/t%d'" % k for k in range(100_000)) + b"]\n",
    "rate 0": b"[output]\nrate_hz = 0\n",
    "rate 1e9": b"[output]\nrate_hz = 1e9\n",
    "delay of a year": b"[gnss]\ndelay_s = 3e7\n",
    "rig is a folder": b"[rig]\nfile = '/'\n",
    "map is a device": b"[map]\nlandmarks = '/dev/zero'\n",
    "map is absent": b"[map]\nlandmarks = '/absent'\n",
    "rig path with a nul": b'[rig]\nfile = "a\\u0000b"\n',
    "endpoint": b"[mavlink]\nendpoint = 'udpin:999.0.0.1:99999999'\n",
    "endpoint is a file": b"[mavlink]\nendpoint = '/etc/passwd'\n",
    "zenoh endpoint": b"[zenoh]\nlisten = ['tcp/\\u0000']\n",
    "log folder is a file": b"[log]\nfolder = '/etc/passwd'\n",
    "keep -1": b"[log]\nkeep_gb = -1\n",
    "unset variable": b"[log]\nfolder = '${ABSENT}'\n",
}
_SOUND: Final = frozenset({"truth", "rate 0", "100,000 topics", "log folder is a file"})  # odd, and no error
_ESCAPE: Final = "\x1b]0;mine\x07\x1b[2J"
LOG: Final = "whole.mcap"  # a good one
_ARGUMENTS: Final[dict[str, tuple[tuple[str, ...], frozenset[int]]]] = {
    "no command": ((), ANY),
    "unknown command": (("fly",), USAGE),
    "unknown option": (("replay", "--fast"), USAGE),
    "escapes for a command": ((_ESCAPE,), USAGE),
    "escapes for a log": (("replay", _ESCAPE, "-o", "o.mcap"), ANY),
    "escapes for a kind": (("import", _ESCAPE, "x", "-o", "o.mcap"), ANY),
    "a line break for a log": (("evaluate", "a\nb.mcap"), ANY),
    "an empty log": (("evaluate", ""), ANY),
    "a surrogate": (("evaluate", "a\udcff.mcap"), ANY),
    "a log of 5,000 letters": (("evaluate", "a" * 5000), ANY),
    "100 layers": (("evaluate", "../" * 100 + "etc/passwd"), REFUSED),
    "option for a log": (("evaluate", "--", "-c"), ANY),
    "out over its input": (("replay", LOG, "-o", LOG), REFUSED | USAGE),
    "out over its input, by another name": (("replay", LOG, "-o", "./sub/../" + LOG), REFUSED | USAGE),
    "out over its input, by a link": (("replay", LOG, "-o", "link.mcap"), REFUSED | USAGE),
    "out over its configuration": (("replay", LOG, "-o", "c.toml", "-c", "c.toml"), REFUSED | USAGE),
    "out is a folder": (("replay", LOG, "-o", "sub"), REFUSED | USAGE),
    "out is full": (("export", LOG, "-o", "/dev/full"), ANY),
    "out in no folder": (("replay", LOG, "-o", "absent/o.mcap"), ANY),
    "out in /proc": (("replay", LOG, "-o", "/proc/o.mcap"), REFUSED),
    "an empty out": (("replay", LOG, "-o", ""), REFUSED | USAGE),
    "prior nan": (
        ("locate", "a.jpg", "--rig", "rig.yaml", "--map", "map.geojson", "--prior", "nan,nan,nan,0,0,0"),
        REFUSED | USAGE,
    ),
    "prior of words": (("locate", "a.jpg", "--rig", "rig.yaml", "--map", "map.geojson", "--prior", "a,b,c"), REFUSED | USAGE),
    "latitude 1e9": (("map", "get", "1e9,0", "--source", "map.geojson", "-o", "m.geojson"), REFUSED | USAGE),
    "latitude inf": (("map", "get", "inf,0", "--source", "map.geojson", "-o", "m.geojson"), REFUSED | USAGE),
    "radius nan": (("map", "get", "47.4,8.5", "--km", "nan", "--source", "map.geojson", "-o", "m.geojson"), USAGE),
    "outage nan": (("evaluate", LOG, "--outage", "nan"), REFUSED | USAGE),
    "outage -1": (("evaluate", LOG, "--outage", "-1"), USAGE),
    "burn-in inf": (("evaluate", LOG, "--burn-in", "inf"), ANY),
    "rate nan": (("export", LOG, "-o", "o.csv", "--rate", "nan"), REFUSED | USAGE),
    "rate -1": (("export", LOG, "-o", "o.csv", "--rate", "-1"), REFUSED | USAGE),
    "geoid inf": (("export", LOG, "-o", "o.kml", "--geoid", "inf"), REFUSED | USAGE),
    "jobs -1": (("tune", LOG, "-o", "t.toml", "--jobs", "-1"), USAGE),
    "jobs of a word": (("tune", LOG, "-o", "t.toml", "--jobs", "all"), USAGE),
    "a key that is none": (("tune", LOG, "-o", "t.toml", "--vary", "imu.__class__"), REFUSED | USAGE),
    "a scheduler that is none": (("tune", LOG, "-o", "t.toml", "--scheduler", "tcp://127.0.0.1:1"), REFUSED | USAGE),
    "every -5": (("overlay", LOG, "--every", "-5"), USAGE),
    "start inf": (("overlay", LOG, "--start", "inf"), REFUSED | USAGE),
    "connect to nobody": (("monitor", "--connect", "tcp/127.0.0.1:1", "--seconds", "1"), REFUSED),
    "connect to words": (("monitor", "--connect", "there", "--seconds", "1"), REFUSED | USAGE),
    "seconds nan": (("monitor", "--connect", "tcp/127.0.0.1:1", "--seconds", "nan"), REFUSED | USAGE),
    "a unit of words": (("forecast", "route.gpx", "--map", "map.geojson", "--speed", "fast"), USAGE),
    "axes of seven": (("import", "csv", "sub", "-o", "o.mcap", "--axes", "forwards"), REFUSED | USAGE),
    "topic with a nul": (("evaluate", LOG, "--truth", "/a b\t"), REFUSED),
}


def configurations(folder: Path, _: Path) -> Iterator[Cell]:
    """For the check of a configuration, and for its use."""
    for name, text in _CONFIGURATIONS.items():
        path = folder / f"{name.replace('/', ' ')}.toml"
        path.mkdir() if name == "a directory" else path.write_bytes(text)
        codes = READ_OR_REFUSED if name in _SOUND else REFUSED | USAGE
        yield Cell("configuration", f"doctor: {name}", ("doctor", "-c", str(path)), codes)
        yield Cell("configuration", f"replay: {name}", ("replay", LOG, "-o", "o.mcap", "-c", str(path)), ANY)


def arguments(folder: Path, _: Path) -> Iterator[Cell]:
    """Of all commands."""
    (folder / "link.mcap").symlink_to(folder / LOG)
    (folder / "sub").mkdir()
    (folder / "c.toml").write_text("[imu]\naxes = 'frd'\n")
    (folder / "a.jpg").write_bytes(b"")
    (folder / "route.gpx").write_text("47.4,8.5\n47.5,8.6\n")
    for name, (words, codes) in _ARGUMENTS.items():
        yield Cell("argument", name, words, codes)
