"""What odometry carries through an outage: the published VIO of the EuRoC flights (vision.csv) as external odometry.

python -m benchmarks.flights.odometry                            with it and with the IMU alone (some minutes on one core)
python -m benchmarks.flights.odometry --flights MH_03_medium --every 5 --config odometry.toml

One pass through each flight with a fix every half second; from every few seconds of it a copy of the estimator goes on without
fixes for up to 60 s. Its error, NEES/3 and the share inside the 95 % ellipsoid are those of the position after 10, 30 and 60 s.
"""

import argparse
import copy
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from benchmarks.flights.tasks import INSIDE95, ROOT, Task, flights, make, vision_poses
from benchmarks.tables import Table
from estimator.config import load
from estimator.fusion import Fusion
from logs.store.reader import LogReader
from logs.wire import axes
from logs.wire.codec import Decoder, ImuMounting, Topics, decode_odometry
from models.messages import Array, Estimate, Input, OdometryPose, PoseFix
from models.state import E, X

VARIANTS: Final = {"none": "IMU alone", "poses": "published VIO"}
ENDS_S: Final = (10.0, 30.0, 60.0)
FIRST_S: Final = 30.0
SECOND: Final = 1_000_000_000
NEAR_NS: Final = 6_000_000
FRAME_NS: Final = 50_000_000
FRAME_LATE: Final = {"MH_04_difficult", "V1_01_easy", "V1_02_medium"}  # the monocular results are stamped one frame late


class End(msgspec.Struct, frozen=True):
    """One outage of one flight after so many seconds: error [m], NEES/3, root of the covariance's trace [m]."""

    variant: str
    after_s: float
    error_m: float
    ratio: float
    sigma_m: float


class Flight(msgspec.Struct, frozen=True):
    """IMU and fixes, the published VIO, and the truth (stamps, positions in n)."""

    messages: list[Input]
    poses: list[OdometryPose]
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
    return Flight(messages, poses, np.array([o.t_ns for o in truth]), np.array([o.p_n for o in truth]), path)


def _pose(t_ns: int, pose: object) -> OdometryPose:
    """A VIO is some 50 ms late."""
    p, q = pose.position, pose.orientation  # type: ignore[attr-defined]
    p_o, q_ob = axes.world((p.x, p.y, p.z)), axes.attitude((q.w, q.x, q.y, q.z))
    return OdometryPose(t_ns, t_ns + SECOND // 20, p_o, q_ob, topic="/odometry")


def outages(flight: Flight, variant: str, config: Path | None, every_s: float) -> Iterator[End]:
    """All outages of one flight: a pass with fixes, a copy of the estimator from each start on without."""
    begin_ns, end_ns = flight.messages[0].t_ns, int(flight.truth_ns[-1])
    fusion = Fusion(load(config or flight.task_file.with_suffix(".toml")).fusion())
    messages = sorted((*flight.messages, *(flight.poses if variant == "poses" else [])), key=lambda m: m.arrived_ns)
    k = 0
    for start_s in np.arange(FIRST_S, (end_ns - begin_ns) * 1e-9 - ENDS_S[0], every_s).tolist():
        start_ns = begin_ns + round(start_s * SECOND)
        while messages[k].arrived_ns <= start_ns:
            fusion.handle(messages[k])
            k += 1
        later = [m for m in messages[k:] if not isinstance(m, PoseFix)]
        yield from _ends(copy.deepcopy(fusion), flight, variant, start_ns, later)


def _ends(fusion: Fusion, flight: Flight, variant: str, start_ns: int, messages: Iterable[Input]) -> Iterator[End]:
    left = list(ENDS_S)
    for out in (out for message in messages for out in fusion.handle(message)):
        late_ns = out.t_ns - start_ns - round(left[0] * SECOND) if isinstance(out, Estimate) else -SECOND
        if not isinstance(out, Estimate) or late_ns < -SECOND // 400:
            continue
        row = int(np.argmin(np.abs(flight.truth_ns - out.t_ns)))
        if abs(int(flight.truth_ns[row]) - out.t_ns) <= NEAR_NS:
            error, cov = flight.truth[row] - out.nav[X.P], out.covariance[E.P, E.P]
            ratio = float(error @ np.linalg.solve(cov, error)) / 3.0
            yield End(variant, left.pop(0), float(np.linalg.norm(error)), ratio, float(np.sqrt(np.trace(cov))))
        elif late_ns > SECOND:
            left.pop(0)
        if not left:
            return


def table(ends: list[End]) -> Table:
    """A row for each variant and length of the outage."""
    rows = []
    for variant, after_s in dict.fromkeys((e.variant, e.after_s) for e in ends):
        those = [e for e in ends if (e.variant, e.after_s) == (variant, after_s)]
        errors = np.array([e.error_m for e in those])
        of_errors = (f"{x:.2f}" for x in (np.median(errors), np.percentile(errors, 95), errors.max()))
        inside = f"{100 * np.mean([3.0 * e.ratio < INSIDE95 for e in those]):.0f}"
        ratio, sigma = f"{np.mean([e.ratio for e in those]):.2f}", f"{np.median([e.sigma_m for e in those]):.2f}"
        rows.append((VARIANTS[variant], f"{after_s:.0f} s", str(len(those)), *of_errors, ratio, inside, sigma))
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
            print(name, variant, flush=True)
    (args.out / "report.md").write_text(table(ends).markdown())
    print(table(ends).markdown())


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", nargs="+", metavar="NAME")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    parser.add_argument("--every", type=float, default=15.0, metavar="S", help="an outage begins every so many seconds")
    parser.add_argument("--config", type=Path, metavar="TOML", help="in place of the task's own")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "bench_odometry")
    return parser.parse_args()


if __name__ == "__main__":
    main()
