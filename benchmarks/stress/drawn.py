# ruff: noqa: ARG001  (one signature for all)
"""Faults drawn at random, and for how long true fixes are locked out after the last faulty reading.

python -m benchmarks.stress.drawn --draws 2000 --rows benchmarks/results/lockout.jsonl --resume

Drawn are flight, fix rate, GNSS or not (beside fixes, or after those of the first 10 s alone), an outage before the fault or not,
and one fault or two, of any kind and size. The bound:
true fixes lead again after three more of them than there were false ones, or 3 s, whichever is longer. They lead where the error
is within twice the largest one of the same flight without a fault (1 m at least), and stays so for two seconds.
"""

import argparse
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TypeAlias

import msgspec
import numpy as np

from benchmarks.flights.tasks import ROOT
from benchmarks.jobs import run_jobs
from benchmarks.stress.cell import OVERCONFIDENT, errors, naive
from benchmarks.stress.flights import ALIGNED_S, SIMULATED, Flight
from benchmarks.stress.perturbations import Rng, direction, level, rarer, turned
from benchmarks.tables import Table, number
from estimator.config import parse
from estimator.fusion import Fusion
from models.frames import Origin
from models.messages import Array, Estimate, GnssFix, ImuSample, Input, PoseFix, vec3
from models.sim.aids import Gnss, PoseFixes
from models.sim.faults import in_order
from models.sim.scenario import Scenario, simulate
from models.sim.sensors import Imu

SEEDS = 4
EARLIEST_S, LATEST_S, SETTLED_S = 18.0, 30.0, 12.0  # onsets; errors count from
OUTAGE_S = (4.0, 12.0)  # before a fault
COUNTS, LONGEST_S = (1, 3, 8, 20), 20.0  # of false readings
LEAST_M, TWICE = 1.0, 2.0
_DEFORMED: tuple[tuple[str, Array], ...] = (
    ("x as y", np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])),
    ("z reversed", np.diag([1.0, -1.0, -1.0])),
    ("twice", 2.0 * np.eye(3)),
    ("a tenth", 0.1 * np.eye(3)),
)
_MORE, _LEAST_S, _STAYS_S, _SAMPLE_S = 3, 3.0, 2.0, 0.02
_END_S = 110.0

Fault: TypeAlias = tuple[str, list[Input], set[int]]  # words, messages, stamps of the faulty readings

_replace = msgspec.structs.replace


class Drawn(msgspec.Struct, frozen=True):
    """One draw. false: faulty positions; bound_s, locked_s: from the last faulty reading on, None: to the end; naive_s: the same
    of the plain filter, where the bound is missed; overconfident: share of the time from the first fault on.
    """

    flight: str
    faults: str
    false: int
    bound_s: float
    locked_s: float | None
    naive_s: float | None
    overconfident: float

    @property
    def missed(self) -> bool:
        """Whether true fixes are locked out for longer than the bound."""
        return self.locked_s is None or self.locked_s > self.bound_s + _SAMPLE_S


def run(job: tuple[int]) -> Drawn:
    """Draw number job[0]."""
    rng = np.random.default_rng(job[0])
    name, with_gnss, period_s = str(rng.choice(list(SIMULATED))), bool(rng.random() < 0.4), float(rng.choice([0.5, 2.0]))
    seed, alone = int(rng.integers(SEEDS)), with_gnss and bool(rng.random() < 1 / 3)
    key = name, "GNSS alone" if alone else "GNSS" if with_gnss else "", period_s, seed
    flight, begin_ns = _flight(*key), _flight(*key).start_ns
    onset_s = float(rng.uniform(EARLIEST_S, LATEST_S))
    messages = flight.messages
    if rng.random() < 0.5 and not with_gnss:
        gap_s = float(rng.uniform(*OUTAGE_S))
        messages = [m for m in messages if not isinstance(m, PoseFix) or not onset_s - gap_s < _seconds(m, begin_ns) < onset_s]
    said, faulty = list[str](), set[int]()
    for _ in range(1 if rng.random() < 2 / 3 else 2):
        kinds = [*([] if alone else _FIXES), *_IMU, *(_GNSS_KINDS if with_gnss else [])]
        words, messages, stamps = kinds[int(rng.integers(len(kinds)))](messages, begin_ns, onset_s, rng, flight)
        said.append(words)
        faulty |= stamps
        onset_s = min(max((max(faulty) - begin_ns) * 1e-9, onset_s) + float(rng.uniform(0.0, 3.0)), LATEST_S + 8.0)
    positions = [m for m in messages if isinstance(m, PoseFix) or (with_gnss and isinstance(m, GnssFix))]
    false = sum(m.t_ns in faulty for m in positions)
    last_ns = max(faulty)
    of_fixes = not alone and any(isinstance(m, PoseFix) and m.t_ns in faulty for m in messages)
    rate = PoseFix if of_fixes or not with_gnss else GnssFix
    true_ns = [m.t_ns for m in positions if m.t_ns > last_ns and isinstance(m, rate)]
    after = false + _MORE
    bound_s = max(_LEAST_S, (true_ns[after - 1] - last_ns) * 1e-9) if len(true_ns) >= after else _END_S
    limit_m = max(LEAST_M, TWICE * _usual_m(*key))
    t_s, off, radius = errors(_estimates(messages, flight), flight, SETTLED_S)
    locked = locked_s(t_s, off, limit_m, (last_ns - begin_ns) * 1e-9)
    since = t_s > onset_s - 1.0
    over = float(np.mean(off[since] > OVERCONFIDENT * radius[since])) if since.any() else 0.0
    plain_s = None
    if locked is None or locked > bound_s:
        plain_t, plain, _ = errors(naive(messages, flight), flight, SETTLED_S)
        plain_s = locked_s(plain_t, plain, limit_m, (last_ns - begin_ns) * 1e-9)
    what = " ".join(filter(None, (name, key[1], "" if alone else f"{period_s:g} s")))
    return Drawn(what, "; ".join(said), false, bound_s, locked, plain_s, over)


def _estimates(messages: list[Input], flight: Flight) -> list[Estimate]:
    fusion = Fusion(flight.config)
    return [o for m in messages for o in fusion.handle(m) if isinstance(o, Estimate)]


def locked_s(t_s: Array, off: Array, limit_m: float, last_s: float) -> float | None:
    """From last_s on, until the error is within the limit and stays there."""
    after = t_s >= last_s
    t, wrong = t_s[after], off[after] > limit_m
    for k in np.flatnonzero(~wrong):
        if not wrong[k : np.searchsorted(t, t[k] + _STAYS_S)].any():
            return float(max(t[k] - last_s, 0.0))
    return None


@cache
def _flight(name: str, gnss: str, period_s: float, seed: int) -> Flight:
    scenario = Scenario(
        duration_s=_END_S,
        vehicle=SIMULATED[name],
        imu=Imu(rate_hz=100.0),
        gnss=Gnss() if gnss else None,
        pose_fix=PoseFixes(),
    )
    made = simulate(scenario, seed)
    truth, config = made.truth, parse(made.config_toml, "simulated").fusion()
    messages = rarer(made.messages, period_s, 0.0)
    if gnss == "GNSS alone":
        messages = [m for m in messages if not isinstance(m, PoseFix) or _seconds(m, messages[0].t_ns) < ALIGNED_S]
    return Flight(messages, truth.t_ns, truth.p_n, truth.v_n, truth.R_nb, (), config)


@cache
def _usual_m(name: str, gnss: str, period_s: float, seed: int) -> float:
    """The largest error without a fault."""
    flight = _flight(name, gnss, period_s, seed)
    _, off, _ = errors(_estimates(flight.messages, flight), flight, SETTLED_S)
    return float(off.max())


def _seconds(m: Input, begin_ns: int) -> float:
    return (m.t_ns - begin_ns) * 1e-9


def _chosen(messages: list[Input], kind: type, begin_ns: int, onset_s: float, rng: Rng) -> set[int]:
    """Stamps of the first messages of a kind from onset_s on, a number of COUNTS, but no longer than LONGEST_S."""
    after = [m.t_ns for m in messages if isinstance(m, kind) and 0.0 <= _seconds(m, begin_ns) - onset_s < LONGEST_S]
    return set(after[: int(rng.choice(COUNTS))])


def false_fixes(messages: list[Input], begin_ns: int, onset_s: float, rng: Rng, flight: Flight) -> Fault:
    """A cluster of fixes with one offset, or one that drifts."""
    drifts, stamps = bool(rng.random() < 0.4), _chosen(messages, PoseFix, begin_ns, onset_s, rng)
    size, speed = float(rng.uniform(2.0, 30.0)), float(rng.uniform(0.5, 5.0))
    way = np.add(level(rng), (0.0, 0.0, rng.normal(0.0, 0.3)))
    turn = np.radians(rng.uniform(0.0, 20.0)) * direction(rng)
    first_ns = min(stamps)

    def off(m: PoseFix) -> PoseFix:
        if drifts:
            return _replace(m, p_n=vec3(m.p_n + speed * (m.t_ns - first_ns) * 1e-9 * way))
        return _replace(turned(m, turn), p_n=vec3(m.p_n + size * way))

    words = f"{len(stamps)} fixes drift at {speed:.1f} m/s" if drifts else f"{len(stamps)} fixes {size:.0f} m off"
    return words, [off(m) if isinstance(m, PoseFix) and m.t_ns in stamps else m for m in messages], stamps


def frozen_fixes(messages: list[Input], begin_ns: int, onset_s: float, rng: Rng, flight: Flight) -> Fault:
    """The last fix under new stamps."""
    stamps = _chosen(messages, PoseFix, begin_ns, onset_s, rng)
    last = next(m for m in reversed(messages) if isinstance(m, PoseFix) and m.t_ns < min(stamps))
    held = [
        _replace(m, p_n=last.p_n, q_nb_wxyz=last.q_nb_wxyz) if isinstance(m, PoseFix) and m.t_ns in stamps else m
        for m in messages
    ]
    return f"{len(stamps)} fixes repeat", held, stamps


def turned_fixes(messages: list[Input], begin_ns: int, onset_s: float, rng: Rng, flight: Flight) -> Fault:
    """The heading of some fixes is another, their position is right."""
    stamps, angle = _chosen(messages, PoseFix, begin_ns, onset_s, rng), float(rng.uniform(30.0, 180.0))
    turn = np.radians(angle) * np.array([0.0, 0.0, 1.0])
    found = [turned(m, turn) if isinstance(m, PoseFix) and m.t_ns in stamps else m for m in messages]
    return f"heading of {len(stamps)} fixes {angle:.0f} deg off", found, stamps


def scattered_fixes(messages: list[Input], begin_ns: int, onset_s: float, rng: Rng, flight: Flight) -> Fault:
    """Each fix is elsewhere."""
    stamps, size = _chosen(messages, PoseFix, begin_ns, onset_s, rng), float(rng.uniform(2.0, 30.0))
    found = [
        _replace(m, p_n=vec3(m.p_n + size * rng.standard_normal(3))) if isinstance(m, PoseFix) and m.t_ns in stamps else m
        for m in messages
    ]
    return f"{len(stamps)} fixes scatter by {size:.0f} m", found, stamps


def stepped_clock(messages: list[Input], begin_ns: int, onset_s: float, rng: Rng, flight: Flight) -> Fault:
    """Stamps of some fixes are late; then the clock is right again."""
    stamps, late_s = _chosen(messages, PoseFix, begin_ns, onset_s, rng), float(rng.uniform(0.1, 0.45))
    late_ns = round(late_s * 1e9)
    moved = [
        _replace(m, t_ns=m.t_ns + late_ns, arrived_ns=m.arrived_ns + late_ns)
        if isinstance(m, PoseFix) and m.t_ns in stamps
        else m
        for m in messages
    ]
    return f"clock of {len(stamps)} fixes {late_s:.2f} s late", in_order(moved), {t_ns + late_ns for t_ns in stamps}


def _imu_for(
    messages: list[Input], begin_ns: int, onset_s: float, seconds: float, change: Callable[[ImuSample], ImuSample]
) -> tuple[list[Input], set[int]]:
    is_in = {m.t_ns for m in messages if isinstance(m, ImuSample) and onset_s <= _seconds(m, begin_ns) < onset_s + seconds}
    return [change(m) if isinstance(m, ImuSample) and m.t_ns in is_in else m for m in messages], is_in


def held_imu(messages: list[Input], begin_ns: int, onset_s: float, rng: Rng, flight: Flight) -> Fault:
    """The last sample under new stamps."""
    seconds = float(rng.uniform(0.2, 2.0))
    last = next(m for m in messages if isinstance(m, ImuSample) and _seconds(m, begin_ns) >= onset_s)
    found = _imu_for(messages, begin_ns, onset_s, seconds, lambda m: _replace(m, gyro_b=last.gyro_b, accel_b=last.accel_b))
    return f"IMU held {seconds:.1f} s", *found


def biased_imu(messages: list[Input], begin_ns: int, onset_s: float, rng: Rng, flight: Flight) -> Fault:
    """An offset of all samples."""
    seconds, size = float(rng.uniform(0.5, 5.0)), float(rng.choice([1.0, 3.0, 10.0]))
    gyro = size * np.radians(1.0) * direction(rng) * (rng.random() < 0.7)
    accel = size * 0.6 * direction(rng) * (not gyro.any() or rng.random() < 0.5)
    found = _imu_for(
        messages, begin_ns, onset_s, seconds,
        lambda m: _replace(m, gyro_b=vec3(m.gyro_b + gyro), accel_b=vec3(m.accel_b + accel)),
    )  # fmt: skip
    return f"IMU {size:g} x biased {seconds:.1f} s", *found


def dead_axis(messages: list[Input], begin_ns: int, onset_s: float, rng: Rng, flight: Flight) -> Fault:
    """One axis reads one value."""
    seconds, axis = float(rng.uniform(1.0, 5.0)), int(rng.integers(6))

    def dead(m: ImuSample) -> ImuSample:
        values = [*m.gyro_b, *m.accel_b]
        values[axis] = 0.0
        return _replace(m, gyro_b=vec3(values[:3]), accel_b=vec3(values[3:]))

    return f"IMU axis {axis} dead {seconds:.1f} s", *_imu_for(messages, begin_ns, onset_s, seconds, dead)


def noisy_imu(messages: list[Input], begin_ns: int, onset_s: float, rng: Rng, flight: Flight) -> Fault:
    """Noise of 2 m/s^2 to 20 m/s^2 and 10 deg/s to 100 deg/s."""
    seconds, size = float(rng.uniform(0.5, 4.0)), float(rng.choice([1.0, 3.0, 10.0]))
    found = _imu_for(
        messages, begin_ns, onset_s, seconds,
        lambda m: _replace(
            m, gyro_b=vec3(m.gyro_b + 0.17 * size * rng.standard_normal(3)),
            accel_b=vec3(m.accel_b + 2.0 * size * rng.standard_normal(3)),
        ),
    )  # fmt: skip
    return f"IMU {size:g} x noisy {seconds:.1f} s", *found


def deformed_imu(messages: list[Input], begin_ns: int, onset_s: float, rng: Rng, flight: Flight) -> Fault:
    """Axes exchanged or reversed, or another unit, of one sensor or both."""
    seconds, which = float(rng.uniform(0.5, 5.0)), int(rng.integers(3))
    words, change = _DEFORMED[int(rng.integers(len(_DEFORMED)))]
    of_gyro, of_accel = change if which != 1 else np.eye(3), change if which != 0 else np.eye(3)
    found = _imu_for(
        messages, begin_ns, onset_s, seconds,
        lambda m: _replace(m, gyro_b=vec3(of_gyro @ m.gyro_b), accel_b=vec3(of_accel @ m.accel_b)),
    )  # fmt: skip
    return f"{('gyro', 'accel', 'IMU')[which]} {words} {seconds:.1f} s", *found


def gnss_jumps(messages: list[Input], begin_ns: int, onset_s: float, rng: Rng, flight: Flight) -> Fault:
    """Positions of the receiver with one offset, or one that drifts."""
    stamps = _chosen(messages, GnssFix, begin_ns, onset_s, rng)
    drifts, size, way = bool(rng.random() < 0.4), float(rng.uniform(5.0, 60.0)), level(rng)
    origin = Origin.of(flight.config.origin)
    assert origin is not None
    first_ns, speed = min(stamps), float(rng.uniform(0.5, 5.0))

    def off(m: GnssFix) -> GnssFix:
        by = speed * (m.t_ns - first_ns) * 1e-9 if drifts else size
        lat, lon, alt = origin.to_geodetic(np.add(origin.to_ned(m.lat_deg, m.lon_deg, m.alt_m), by * way))
        return _replace(m, lat_deg=lat, lon_deg=lon, alt_m=alt)

    words = f"{len(stamps)} GNSS " + (f"drift at {speed:.1f} m/s" if drifts else f"{size:.0f} m off")
    return words, [off(m) if isinstance(m, GnssFix) and m.t_ns in stamps else m for m in messages], stamps


_FIXES = [false_fixes, false_fixes, turned_fixes, scattered_fixes, frozen_fixes, stepped_clock]
_IMU = [held_imu, biased_imu, dead_axis, noisy_imu, deformed_imu]
_GNSS_KINDS = [gnss_jumps, gnss_jumps]


def lockout_table(rows: list[Drawn]) -> Table:
    """One row a kind of first fault: draws, within the bound, the worst, and the plain filter where it is missed."""
    by_kind: dict[str, list[Drawn]] = {}
    for row in rows:
        words = [w for w in row.faults.split("; ")[0].split() if not w[0].isdigit()]
        by_kind.setdefault(" ".join(words[:3]) + (" + another" if ";" in row.faults else ""), []).append(row)
    lines = [
        (kind, str(len(those)), str(sum(not r.missed for r in those)),
         number(float(np.percentile([_END_S if r.locked_s is None else r.locked_s for r in those], 95))),
         number(max(_END_S if r.locked_s is None else r.locked_s for r in those)),
         str(sum(r.missed and r.naive_s is not None and r.naive_s <= r.bound_s for r in those)),
         number(100.0 * float(np.mean([r.overconfident for r in those]))))
        for kind, those in sorted(by_kind.items())
    ]  # fmt: skip
    columns = ("fault", "draws", "within the bound", "95 % s", "worst s", "plain filter within where missed", "overconfident %")
    return Table(f"Lock-out ({len(rows)} draws, {sum(r.missed for r in rows)} beyond the bound)", columns, lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="number of the first draw")
    parser.add_argument("--rows", type=Path, default=ROOT / "out" / "stress" / "lockout.jsonl")
    parser.add_argument("--resume", action="store_true", help="keep the rows of an earlier run that was ended")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    args = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = "1"  # inherited: one thread a process
    draws = [(k,) for k in range(args.first, args.first + args.draws)]
    rows = run_jobs(draws, run, Drawn, args.rows, processes=args.jobs, resume=args.resume)
    print(lockout_table(rows).markdown())
    for (k,), row in zip(draws, rows, strict=True):
        if row.missed:
            print(f"{k}: {row.flight}: {row.faults}: {row.locked_s} s of {row.bound_s:.1f} s, plain filter {row.naive_s}")


if __name__ == "__main__":
    main()
