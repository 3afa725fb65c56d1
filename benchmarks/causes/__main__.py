"""Draws faults blind into recorded flights, and judges the same flights as they are.

python -m benchmarks.causes [--seeds 120] [--sound 40] [-o rows.jsonl]
"""

import argparse
from functools import cache
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from benchmarks.causes.faults import FAULTS, Messages
from benchmarks.causes.files import FILE_FAULTS, said_of
from benchmarks.flights.tasks import ROOT, data_folder
from estimator.version import version
from logs.findings import Watch
from logs.importers import ImportOptions, Truth, read
from models.messages import GnssFix, GnssVelocity, ImuSample, Input, OdometryPose, PoseFix, Reading, Vec3

FLIGHTS: Final = {  # folder -> topics by kind of fault
    "inertialnav_logs/quad106": ("imu", "gnss", "velocity", "baro"),
    "umn_thor75": ("imu", "gnss", "moving", "velocity", "baro", "field"),
    "rtk_drive_walk/drive_0708": ("imu", "gnss", "velocity"),
    "quad_rtk_dot/flight_a": ("imu", "gnss"),
    "euroc/V1_01_easy": ("imu", "pose", "odometry", "turning"),
    "euroc/MH_04_difficult": ("imu", "pose", "odometry", "turning"),
    "euroc/V2_02_medium": ("imu", "pose", "odometry", "turning"),
}
_KINDS: Final[dict[str, type]] = {"imu": ImuSample, "turning": ImuSample,
                 "gnss": GnssFix, "moving": GnssFix, "velocity": GnssVelocity, "pose": PoseFix,
                 "odometry": OdometryPose}  # fmt: skip
_READINGS: Final = {"baro": "baro", "field": "magnetometer"}
_LONG_S: Final = 80.0


class Row(msgspec.Struct, frozen=True):
    """One log. fault: "" where it is sound; named: the first sentence has the topic and the cause."""

    seed: int
    flight: str
    fault: str
    topic: str
    named: bool
    first: str
    version: str


@cache
def flight(name: str) -> tuple[Messages, Vec3 | None]:
    """Its messages in the order of arrival, and the origin of its map."""
    euroc = name.startswith("euroc")
    options = ImportOptions(pose_fix_hz=2.0 if euroc else 0.0, odometry=euroc)
    recording = read("csv", data_folder() / "flights" / name, options)
    return [m for m in recording if not isinstance(m, Truth)], recording.settings.origin


def stretch(name: str, rng: np.random.Generator) -> Messages:
    """80 s of it, from anywhere, each topic with a delay of its own that scatters."""
    messages, _ = flight(name)
    first, last = messages[0].arrived_ns, messages[-1].arrived_ns
    start = first + int(rng.uniform(0.1, 0.9) * max(0, last - first - int(1e9 * _LONG_S)))
    delay, newest, moved = dict[str, int](), dict[str, int](), list[Input]()
    for m in messages:
        if start <= m.arrived_ns < start + int(1e9 * _LONG_S):
            usual = delay.setdefault(m.topic, int(rng.integers(1, 40)) * 10**6)
            newest[m.topic] = max(newest.get(m.topic, 0), m.arrived_ns + usual + int(rng.exponential(2e6)))  # in their order
            moved.append(msgspec.structs.replace(m, arrived_ns=newest[m.topic]))
    return sorted(moved, key=lambda m: m.arrived_ns)


def _is(message: Input, kind: str) -> bool:
    if kind in _READINGS:
        return isinstance(message, Reading) and message.kind == _READINGS[kind]
    return isinstance(message, _KINDS[kind])


def drawn(seed: int, *, sound: bool) -> Row:
    """One log, with a fault unless it is sound."""
    rng = np.random.default_rng([seed, int(sound)])
    label = "" if sound else str(rng.choice([*FAULTS, *FILE_FAULTS]))
    if label in FILE_FAULTS:
        return _of_a_file(seed, label, rng)
    fault = FAULTS.get(label)
    name = str(rng.choice([f for f, kinds in FLIGHTS.items() if fault is None or fault.kind in kinds]))
    messages, topic = stretch(name, rng), ""
    if fault is not None:
        wanted = [m for m in messages if _is(m, fault.kind)]
        topic = wanted[0].topic
        others = [m for m in messages if m.topic != topic]
        changed = fault.change([m for m in wanted if m.topic == topic], rng)
        messages = sorted([*others, *changed], key=lambda m: m.arrived_ns)
    watch = Watch(flight(name)[1])
    for message in messages:
        watch.add(message)
    found = watch.findings()
    first = str(found[0]) if found else ""
    named = not found if fault is None else bool(found) and found[0].who == topic and any(w in found[0].what for w in fault.words)
    return Row(seed, name, label, topic, named, first, version())


def _of_a_file(seed: int, label: str, rng: np.random.Generator) -> Row:
    """A log whose file is at fault, given to import; where LANDFIX_DATA is absent there are none of autopilots."""
    fault = FILE_FAULTS[label]
    first = said_of(fault, rng)
    return Row(seed, fault.seed, label, fault.file, any(word in first for word in fault.words), first, version())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=120, help="faults drawn")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--sound", type=int, default=40, help="sound logs")
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "out" / "causes.jsonl")
    args = parser.parse_args()
    args.out.parent.mkdir(parents=True, exist_ok=True)
    rows = []
    with args.out.open("wb") as file:
        for is_sound, count in ((False, args.seeds), (True, args.sound)):
            for seed in range(args.first, args.first + count):
                rows.append(drawn(seed, sound=is_sound))
                file.write(msgspec.json.encode(rows[-1]) + b"\n")
                file.flush()
    faults, sound = [r for r in rows if r.fault], [r for r in rows if not r.fault]
    for row in rows:
        if not row.named:
            print(f"{row.seed:4} {row.flight:26} {row.fault or 'sound':22} {row.topic:10} {row.first}")
    accused = sum(not r.named for r in sound)
    print(f"named {sum(r.named for r in faults)} of {len(faults)}; sound logs accused: {accused} of {len(sound)}")


if __name__ == "__main__":
    main()
