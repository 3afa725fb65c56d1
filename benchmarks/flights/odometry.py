"""What odometry carries through an outage: the published VIO of the EuRoC flights (vision.csv) as external odometry.

python -m benchmarks.flights.odometry                            all variants on all flights (some minutes on one core)
python -m benchmarks.flights.odometry --variants none poses      only these
python -m benchmarks.flights.odometry --flights MH_03_medium --every 5 --config odometry.toml

One pass through each flight with a fix every half second; from every few seconds of it a copy of the estimator goes on without
fixes for up to 60 s. Its error, NEES/3 and the share inside the 95 % ellipsoid are those of the position after 10, 30 and 60 s.
"""

import argparse
import copy
import json
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from benchmarks.flights.odometry_faults import FAULTS, SECOND, Fault, Poses
from benchmarks.flights.tasks import INSIDE95, ROOT, Task, flights, make, vision_poses
from benchmarks.tables import Table
from estimator.config import load
from estimator.fusion import Fusion
from logs.store.reader import LogReader
from logs.wire import axes
from logs.wire.codec import Decoder, ImuMounting, Topics, decode_odometry
from models.messages import AidStatus, Array, Estimate, Input, OdometryDelta, OdometryPose, PoseFix, Reason
from models.relative_pose import between
from models.state import E, X

TOPIC: Final = "/odometry"
ENDS_S: Final = (10.0, 30.0, 60.0)
FIRST_S: Final = 30.0
STEP_S: Final = 0.5
NEAR_NS: Final = 6_000_000
FRAME_NS: Final = 50_000_000
FRAME_LATE: Final = {"MH_04_difficult", "V1_01_easy", "V1_02_medium"}  # the monocular results are stamped one frame late


class End(msgspec.Struct, frozen=True):
    """One outage of one flight after so many seconds: error [m], NEES/3, radius of the 95 % ellipsoid's mean axis [m]."""

    flight: str
    variant: str
    start_s: float
    after_s: float
    error_m: float
    ratio: float
    sigma_m: float
    reasons: dict[str, int]

    @property
    def is_inside(self) -> bool:
        """Of the 95 % ellipsoid."""
        return 3.0 * self.ratio < INSIDE95


class Flight(msgspec.Struct, frozen=True):
    """IMU and fixes, the published VIO, and the truth (stamps, positions in n)."""

    name: str
    messages: list[Input]
    poses: Poses
    truth_ns: Array
    truth: Array
    task_file: Path


def read(name: str, folder: Path) -> Flight:
    """The flight as a task without outage. Raises SystemExit where it is not there."""
    task = Task("euroc", name, "N", 0)
    path = make(task, folder)
    if path is None:
        raise SystemExit(f"{name}: no task can be made of it")
    keys = tomllib.loads(path.with_suffix(".toml").read_text())
    decoder = Decoder(Topics.of(keys["inputs"]), ImuMounting(axes=keys["imu"]["axes"]))
    messages, truth = [], []
    with LogReader(path) as reader:
        for record in reader:
            if record.topic == "/truth":
                truth.append(decode_odometry(record.data))
            elif (message := decoder.decode(record.topic, record.schema, record.data, record.log_time_ns)) is not None:
                messages.append(message)
    stamps_ns, found = vision_poses(task)
    late_ns = FRAME_NS if name in FRAME_LATE else 0
    poses = [_pose(t - late_ns, pose) for t, pose in zip(stamps_ns.tolist(), found, strict=True)]
    return Flight(name, messages, poses, np.array([o.t_ns for o in truth]), np.array([o.p_n for o in truth]), path)


def _pose(t_ns: int, pose: object) -> OdometryPose:
    p, q = pose.position, pose.orientation  # type: ignore[attr-defined]
    return OdometryPose(t_ns, t_ns, axes.world((p.x, p.y, p.z)), axes.attitude((q.w, q.x, q.y, q.z)), topic=TOPIC)


def nothing(_poses: Poses, _start_ns: int, _seed: int) -> Iterable[Input]:
    """IMU alone."""
    return ()


def lost(poses: Poses, start_ns: int, seed: int) -> Iterable[Input]:
    """Increments of half a second; one in five is lost, and 4 s in the middle of the first half minute are dark."""
    rng = np.random.default_rng(seed)
    for step in increments(poses):
        is_dark = start_ns + 13 * SECOND < step.t_ns < start_ns + 17 * SECOND
        if rng.random() >= 0.2 and not is_dark:
            yield step


def increments(poses: Poses) -> Iterator[OdometryDelta]:
    """Increments of half a second, chained, without a covariance."""
    before = None
    for pose in poses:
        if before is not None and pose.t_ns - before.t_ns < STEP_S * SECOND:
            continue
        if before is not None and pose.t_ns - before.t_ns < 3 * SECOND:
            p, q = _between(before, pose)
            yield OdometryDelta(pose.t_ns, pose.t_ns, before.t_ns, p, q, np.zeros((6, 6)), topic=TOPIC)
        before = pose


def _between(a: OdometryPose, b: OdometryPose) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    x, y, z, *q = between(np.array((*a.p_o, *a.q_ob_wxyz)), np.array((*b.p_o, *b.q_ob_wxyz))).tolist()
    return (x, y, z), (q[0], q[1], q[2], q[3])


VARIANTS: Final[dict[str, tuple[Fault, str]]] = {
    "none": (nothing, "IMU alone"),
    "lost": (lost, "20 % of the steps lost, 4 s dark"),
    **FAULTS,
}


def outages(
    flight: Flight, variant: str, config: Path | None, every_s: float, starts: list[float] | None = None
) -> Iterator[End]:
    """All outages of one flight: a pass with fixes, a copy of the estimator from each start on without."""
    change, _ = VARIANTS[variant]
    begin_ns, end_ns = flight.messages[0].t_ns, int(flight.truth_ns[-1])
    last_s = (end_ns - begin_ns) * 1e-9 - ENDS_S[0]
    marks = starts or [float(s) for s in np.arange(FIRST_S, last_s, every_s)]
    fusion = Fusion(load(config or flight.task_file.with_suffix(".toml")).fusion())
    healthy = sorted((*flight.messages, *_sent(change(flight.poses, 2**62, 0))), key=lambda m: m.arrived_ns)
    k = 0
    for seed, start_s in enumerate(marks):
        start_ns = begin_ns + round(start_s * SECOND)
        while healthy[k].arrived_ns <= start_ns:
            fusion.handle(healthy[k])
            k += 1
        rest = [m for m in healthy[k:] if not isinstance(m, PoseFix | OdometryPose | OdometryDelta)]
        during = (m for m in _sent(change(flight.poses, start_ns, seed)) if m.arrived_ns > start_ns)
        later = sorted((*rest, *during), key=lambda m: m.arrived_ns)
        yield from _ends(copy.deepcopy(fusion), flight, variant, start_s, start_ns, later)


def _sent(messages: Iterable[Input]) -> Iterator[Input]:
    """A VIO is some 50 ms late."""
    return (msgspec.structs.replace(m, arrived_ns=m.t_ns + SECOND // 20) for m in messages)


def _ends(fusion: Fusion, flight: Flight, variant: str, start_s: float, start_ns: int, messages: list[Input]) -> Iterator[End]:
    wanted = [start_ns + round(s * SECOND) for s in ENDS_S]
    reasons: Counter[str] = Counter()
    for message in messages:
        for out in fusion.handle(message):
            if isinstance(out, AidStatus) and out.topic == TOPIC and out.reason is not Reason.THINNED:
                reasons[str(out.reason)] += 1
            if not (isinstance(out, Estimate) and wanted and out.t_ns >= wanted[0] - SECOND // 400):
                continue
            row = int(np.argmin(np.abs(flight.truth_ns - out.t_ns)))
            after_s = ENDS_S[len(ENDS_S) - len(wanted)]
            if abs(int(flight.truth_ns[row]) - out.t_ns) > NEAR_NS:
                if out.t_ns - wanted[0] > SECOND:
                    wanted.pop(0)
                continue
            error, cov = flight.truth[row] - out.nav[X.P], out.covariance[E.P, E.P]
            ratio = float(error @ np.linalg.solve(cov, error)) / 3.0
            sigma = float(np.sqrt(np.trace(cov)))
            yield End(flight.name, variant, start_s, after_s, float(np.linalg.norm(error)), ratio, sigma, dict(reasons))
            wanted.pop(0)
        if not wanted:
            return


def table(ends: list[End], variants: Iterable[str]) -> Table:
    """A row for each variant and length of the outage."""
    rows = []
    for variant in variants:
        for after_s in ENDS_S:
            those = [e for e in ends if e.variant == variant and e.after_s == after_s]
            if not those:
                continue
            errors = np.array([e.error_m for e in those])
            rows.append(
                (
                    VARIANTS[variant][1],
                    f"{after_s:.0f} s",
                    str(len(those)),
                    f"{np.median(errors):.2f}",
                    f"{np.percentile(errors, 95):.2f}",
                    f"{errors.max():.2f}",
                    f"{np.mean([e.ratio for e in those]):.2f}",
                    f"{100 * np.mean([e.is_inside for e in those]):.0f}",
                    f"{np.median([e.sigma_m for e in those]):.2f}",
                )
            )
    head = ("odometry", "outage", "n", "median m", "95 % m", "max m", "NEES/3", "inside 95 %", "sigma m")
    return Table("Position error at the end of an outage, EuRoC", head, rows)


def main() -> None:
    """See the module."""
    args = arguments()
    ends: list[End] = []
    for name in args.flights or [f for f in flights("euroc") if (Task("euroc", f, "N", 0).folder / "vision.csv").is_file()]:
        flight = read(name, args.out / "tasks")
        for variant in args.variants:
            ends += outages(flight, variant, args.config, args.every)
            print(table([e for e in ends if e.flight == name], [variant]).markdown() if args.verbose else f"{name} {variant}")
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "ends.json").write_text(json.dumps([msgspec.to_builtins(e) for e in ends], indent=1))
    (args.out / "report.md").write_text(table(ends, args.variants).markdown())
    print(table(ends, args.variants).markdown())


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", nargs="+", metavar="NAME")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    parser.add_argument("--every", type=float, default=15.0, metavar="S", help="an outage begins every so many seconds")
    parser.add_argument("--config", type=Path, metavar="TOML", help="in place of the task's own")
    parser.add_argument("--verbose", action="store_true", help="a table for each flight")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "bench_odometry")
    return parser.parse_args()


if __name__ == "__main__":
    main()
