"""Outages with a published VIO of EuRoC and its faults, from three public repositories.

python -m benchmarks.odometry.kept_aside VIO TRUTH IMU -o rows.jsonl                      all flights and faults
python -m benchmarks.odometry.kept_aside VIO TRUTH IMU -o rows.jsonl --variants poses --flights MH_05_stereo

VIO: results/ of uzh-rpg/rpg_trajectory_evaluation; TRUTH: ov_data/euroc_mav of rpng/open_vins; IMU: EuRoC_IMU, as ORB-SLAM3
has it (AbhinandIITM/VI-SLAM, Examples/Monocular-Inertial). A fix of 0.15 m and 1 degree every half second until the outage.
The tracker takes what has arrived in the order of validity; what is late gives the same bits.
"""

import argparse
import json
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from benchmarks.flights.odometry import ENDS_S, FIRST_S
from benchmarks.flights.tasks import INSIDE95
from benchmarks.odometry.faults import FAULTS, SECOND, TOPIC, Poses
from benchmarks.tables import Table
from estimator.filter.alignment import TrackerConfig
from estimator.filter.imu_buffer import ImuBuffer
from estimator.filter.tracker import Tracker
from estimator.fusion import FusionConfig
from estimator.sources.aids import aid_of
from estimator.sources.base.aid import Aid
from logs.wire import axes
from models import so3
from models.imu import ImuNoise
from models.messages import Array, ImuSample, Input, OdometryPose, PoseFix, Quat, Reason, Vec3
from models.state import E, X

_MONO_STEREO, _SLAM = "euroc_mono_stereo/laptop", "euroc_vislam_mono/laptop/vislam_rp/laptop_vislam_rp"
FLIGHTS: Final = {  # file of the VIO, name of the truth
    **{f"{f}_{k}": (f"{_MONO_STEREO}/vio_{k}/laptop_vio_{k}_{f}/stamped_traj_estimate.txt", f)
       for f in ("MH_03", "MH_05", "V2_01", "V2_02", "V2_03") for k in ("stereo", "mono")},
    **{f"{f}_slam{run}": (f"{_SLAM}_{f}/stamped_traj_estimate{run}.txt", f)
       for f in ("MH_03", "MH_04", "MH_05", "V1_01", "V1_02", "V1_03", "V2_01", "V2_02", "V2_03") for run in range(10)},
}  # fmt: skip
FRAME_LATE: Final = {name for name in FLIGHTS if "_slam" in name}  # their estimates are stamped one frame late
CONFIG: Final = FusionConfig(imu=ImuNoise(gyro_noise=7e-4, accel_noise=4e-2, gyro_walk=1e-4, accel_walk=1e-3))
FIX_M, FIX_RAD, FIX_S = 0.15, np.deg2rad(1.0), 0.5
POSE_S: Final = 0.25
NEAR_NS: Final = 30_000_000


class End(msgspec.Struct, frozen=True):
    """One outage after so many seconds: error [m], NEES/3, root of the covariance's trace [m], what health says."""

    flight: str
    variant: str
    start_s: float
    after_s: float
    error_m: float
    ratio: float
    sigma_m: float
    reasons: dict[str, int]
    says: list[str]


class Flight(msgspec.Struct, frozen=True):
    """IMU, fixes in the order of validity, VIO, and the truth: stamps (n,), p_n and q_nb (n, 7)."""

    name: str
    samples: ImuBuffer
    fixes: list[Aid]
    poses: Poses
    truth_ns: NDArray[np.int64]
    truth: Array


def read(name: str, vio: Path, truth: Path, imu: Path) -> Flight:
    """The flight. Raises SystemExit where a file is missing."""
    estimate, flight = FLIGHTS[name]
    files = (imu / f"{flight.replace('_', '')}.txt", next(truth.glob(f"{flight}_*.txt"), truth / f"{flight}.txt"), vio / estimate)
    if missing := [str(file) for file in files if not file.is_file()]:
        raise SystemExit(f"{', '.join(missing)}: not there")
    stamped = np.loadtxt(files[0], delimiter=",")
    stamps_ns = np.loadtxt(files[0], delimiter=",", usecols=0, dtype=np.int64)
    truth_ns, known = _poses(files[1])
    begin_ns, end_ns = max(stamps_ns[0], truth_ns[0]), min(stamps_ns[-1], truth_ns[-1])
    samples = ImuBuffer(len(stamps_ns))
    for t_ns, row in zip(stamps_ns.tolist(), stamped[:, 1:].tolist(), strict=True):
        if begin_ns <= t_ns <= end_ns:
            samples.insert(ImuSample(t_ns, t_ns, _body(row[:3]), _body(row[3:])))
    found_ns, found = _poses(files[2], 50_000_000 if name in FRAME_LATE else 0)
    inside = (found_ns >= begin_ns) & (found_ns <= end_ns) & (np.linalg.norm(found[:, :3], axis=1) > 0.0)
    poses: Poses = []
    for t, row in zip(found_ns[inside].tolist(), found[inside].tolist(), strict=True):
        if not poses or t - poses[-1].t_ns > (POSE_S - 0.01) * SECOND:
            poses.append(OdometryPose(t, t, (row[0], row[1], row[2]), (row[3], row[4], row[5], row[6]), topic=TOPIC))
    return Flight(name, samples, _fixes(truth_ns, known, begin_ns, end_ns), poses, truth_ns, known)


def _poses(file: Path, late_ns: int = 0) -> tuple[NDArray[np.int64], Array]:
    """Stamps and poses (n, 7) in n, of the body in landfix' axes, of `t x y z qx qy qz qw`, that of EuRoC's IMU."""
    rows = np.loadtxt(file)
    stamps_ns, first = np.unique(np.round(rows[:, 0] * 1e9).astype(np.int64) - late_ns, return_index=True)
    return stamps_ns, np.array(
        [(*axes.world((x, y, z)), *_attitude((w, i, j, k))) for _, x, y, z, i, j, k, w in rows[first].tolist()]
    )


def _body(v: list[float]) -> Vec3:
    """EuRoC's IMU has x up and z forward; FRD."""
    return v[2], v[1], -v[0]


def _attitude(q: Quat) -> Quat:
    """q of EuRoC's IMU in its world, of FRD in NED: half a turn about (1, 0, 1) leads from the IMU's axes to FLU."""
    w, x, y, z = so3.multiply(np.array(q), np.array([0.0, 1.0, 0.0, 1.0]) / np.sqrt(2.0)).tolist()
    return axes.attitude((w, x, y, z))


def _fixes(truth_ns: NDArray[np.int64], truth: Array, begin_ns: int, end_ns: int) -> list[Aid]:
    rng, made = np.random.default_rng(1000), list[Input]()
    for t_ns in np.arange(begin_ns, end_ns, FIX_S * SECOND):
        k = min(int(np.searchsorted(truth_ns, t_ns)), len(truth) - 1)
        noise, cov = rng.standard_normal(6), np.diag([FIX_M**2] * 3 + [FIX_RAD**2] * 3)
        x, y, z = (truth[k, :3] + FIX_M * noise[:3]).tolist()
        q = so3.multiply(so3.quat_exp(FIX_RAD * noise[3:]), truth[k, 3:]).tolist()
        at_ns = int(truth_ns[k])
        made.append(PoseFix(at_ns, at_ns, (x, y, z), (q[0], q[1], q[2], q[3]), cov))
    return _aids(made)


def _aids(messages: Iterable[Input]) -> list[Aid]:
    made = (aid_of(message, CONFIG) for message in messages)
    return sorted((aid for aid in made if isinstance(aid, Aid)), key=lambda aid: aid.order)


def outages(flight: Flight, variant: str, every_s: float) -> Iterator[End]:
    """A pass with fixes, a copy of the tracker from each start on without."""
    fault, _ = FAULTS[variant]
    tracker = Tracker(
        TrackerConfig(
            imu=CONFIG.imu, coast=CONFIG.coast, initialise=CONFIG.initialise, origin=None, bounds=CONFIG.bounds,
        )
    )  # fmt: skip
    begin_ns, end_ns = int(flight.samples.t_ns[0]), int(min(flight.truth_ns[-1], flight.samples.newest_ns))
    healthy = sorted([*flight.fixes, *_aids(fault(flight.poses, 2**62, 0))], key=lambda aid: aid.order)
    k = 0
    for seed, start_s in enumerate(np.arange(FIRST_S, (end_ns - begin_ns) / SECOND - ENDS_S[0], every_s).tolist()):
        start_ns = begin_ns + round(start_s * SECOND)
        while healthy[k].t_ns <= start_ns:
            _take(tracker, healthy[k], flight.samples)
            k += 1
        later = [aid for aid in _aids(fault(flight.poses, start_ns, seed)) if aid.t_ns > start_ns]
        yield from _ends(tracker.copy(), flight, variant, start_s, start_ns, later)


def _take(tracker: Tracker, aid: Aid, samples: ImuBuffer) -> Reason:
    tracker.propagate(samples, aid.t_ns)
    return tracker.process(aid, samples).reason


def _ends(tracker: Tracker, flight: Flight, variant: str, start_s: float, start_ns: int, aids: list[Aid]) -> Iterator[End]:
    reasons: Counter[str] = Counter()
    k = 0
    for after_s in ENDS_S:
        end_ns = start_ns + round(after_s * SECOND)
        row = min(int(np.searchsorted(flight.truth_ns, end_ns)), len(flight.truth) - 1)
        if abs(int(flight.truth_ns[row]) - end_ns) > NEAR_NS:
            return
        while k < len(aids) and aids[k].arrived_ns <= end_ns:
            if (reason := _take(tracker, aids[k], flight.samples)) is not Reason.THINNED:
                reasons[str(reason)] += 1
            k += 1
        now = tracker.copy()
        now.propagate(flight.samples, int(flight.truth_ns[row]))
        shown = now.alignment.shown
        if shown is None:
            return
        error, cov = flight.truth[row, :3] - shown.lead.x[X.P], now.shown_covariance()[E.P, E.P]
        ratio, sigma = float(error @ np.linalg.solve(cov, error)) / 3.0, float(np.sqrt(np.trace(cov)))
        yield End(flight.name, variant, start_s, after_s, float(np.linalg.norm(error)), ratio, sigma, dict(reasons), now.remarks)


def table(ends: list[End]) -> Table:
    """A row for each variant and length of the outage."""
    rows = []
    for variant, after_s in dict.fromkeys((e.variant, e.after_s) for e in ends):
        those = [e for e in ends if (e.variant, e.after_s) == (variant, after_s)]
        errors, ratios = np.array([e.error_m for e in those]), np.array([e.ratio for e in those])
        of_errors = (f"{x:.2f}" for x in (np.median(errors), np.percentile(errors, 95), errors.max()))
        inside, sigma = np.mean(3.0 * ratios < INSIDE95), np.median([e.sigma_m for e in those])
        of_ratios = f"{ratios.mean():.2f}", f"{ratios.max():.1f}", f"{100 * inside:.0f}", f"{sigma:.2f}"
        rows.append((FAULTS[variant][1], f"{after_s:.0f} s", str(len(those)), *of_errors, *of_ratios))
    head = ("odometry", "outage", "n", "median m", "95 % m", "max m", "NEES/3", "largest NEES/3", "inside 95 %", "sigma m")
    return Table("Position error at the end of an outage, EuRoC", head, rows)


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for folder in ("vio", "truth", "imu"):
        parser.add_argument(folder, type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="JSONL")
    parser.add_argument("--flights", nargs="+", choices=FLIGHTS, default=list(FLIGHTS), metavar="NAME")
    parser.add_argument("--variants", nargs="+", choices=FAULTS, default=list(FAULTS))
    parser.add_argument("--every", type=float, default=20.0, metavar="S", help="an outage begins every so many seconds")
    args = parser.parse_args()
    ends: list[End] = []
    with args.out.open("w") as out:
        for name in args.flights:
            flight = read(name, args.vio, args.truth, args.imu)
            for variant in args.variants:
                for end in outages(flight, variant, args.every):
                    ends.append(end)
                    out.write(json.dumps(msgspec.to_builtins(end)) + "\n")
                out.flush()
    print(table(ends).markdown())


if __name__ == "__main__":
    main()
