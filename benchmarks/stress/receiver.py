"""A receiver that is jammed or spoofed, with its own flags and without: time to reaction, error, radius.

python -m benchmarks.stress.receiver --resume                      all cells (an hour of one core)
python -m benchmarks.stress.receiver --cells "720 m" --resume

Simulated flights of 80 s, GNSS at 5 Hz, aligned by fixes in the first 6 s; then none, or one each 20 s. From 15 s on: jam:
noise of 10 m and 3 m/s at the usual claim; step: its speed by 2 m/s, positions along; pull: by 0.5 m/s; 720 m: none for 20 s,
then so far off. The receiver flags it from there on, or does not.
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np
from msgspec.structs import replace

from benchmarks.flights.tasks import ROOT
from benchmarks.jobs import run_jobs
from benchmarks.stress.cell import errors
from benchmarks.stress.flights import SIMULATED, Flight
from benchmarks.tables import Table, number
from estimator.config import parse
from estimator.fusion import Fusion
from models.frames import Origin
from models.messages import AidStatus, Array, Estimate, GnssFix, GnssVelocity, Health, Input, PoseFix, Reason, ReceiverState, vec3
from models.sim.aids import Gnss, PoseFixes
from models.sim.scenario import Scenario, simulate
from models.sim.sensors import Imu

CELLS = ("jam", "step", "pull", "720 m")
FIXES_S = (0.0, 20.0)  # between two; 0: none after the alignment
FROM_S, END_S, ALIGNED_S, BLACKOUT_S = 15.0, 80.0, 6.0, 20.0
_SPEED_M_S = {"step": 2.0, "pull": 0.5}
_OFF_M, _JAM_M, _JAM_M_S = 720.0, 10.0, 3.0
_LASTS_S = 10.0
_SEEDS, _RETURNS = 2, 35  # of each cell and flight; of "720 m", without flags

Job = tuple[str, float, bool, str, int]  # cell, seconds between fixes, flagged, flight, seed


class Row(msgspec.Struct, frozen=True):
    """One flight. reaction_s: to the first reading that is not fused, or word of health about it; left_s: to the last one that is
    fused, 10 s and more before the end; None: never; off_m, radius_m: at the largest error.

    outside: share of the estimates beyond their radius; followed: used to the end, which is off by half of what the receiver is.
    """

    cell: str
    fixes_s: float
    flagged: bool
    flight: str
    seed: int
    reaction_s: float | None
    left_s: float | None
    off_m: float
    radius_m: float
    outside: float
    followed: bool


def run(job: Job) -> Row:
    """Fly, and look at what was published from the onset on."""
    cell, fixes_s, flagged, name, seed = job
    flight = _flight(name, seed)
    onset_s = FROM_S + (BLACKOUT_S if cell == "720 m" else 0.0)
    onset_ns = flight.start_ns + round(onset_s * 1e9)
    fusion, estimates, decided, named_ns = Fusion(flight.config), list[Estimate](), dict[int, Reason](), list[int]()
    for message in _disturbed(flight, cell, fixes_s, seed, flagged=flagged):
        for output in fusion.handle(message):
            if isinstance(output, Estimate):
                estimates.append(output)
            elif isinstance(output, AidStatus) and output.topic == "/gnss" and output.t_ns >= onset_ns:
                decided[output.t_ns] = output.reason
            elif isinstance(output, Health) and "/gnss" in output.detail and output.t_ns >= onset_ns:
                named_ns.append(output.t_ns)
    _, off_m, radius_m = errors(estimates, flight, onset_s)
    worst = int(np.argmax(off_m))
    refused_ns = [t_ns for t_ns, reason in decided.items() if reason is not Reason.FUSED]
    last_ns = max((t_ns for t_ns, reason in decided.items() if reason is Reason.FUSED), default=onset_ns)
    seen_ns = min([*refused_ns, *named_ns], default=None)
    left_s, lasted_s = (last_ns - onset_ns) * 1e-9, (max(decided) - last_ns) * 1e-9
    pulled_m = _SPEED_M_S[cell] * (END_S - FROM_S) if cell in _SPEED_M_S else _OFF_M
    return Row(
        *job,
        reaction_s=None if seen_ns is None else (seen_ns - onset_ns) * 1e-9,
        left_s=left_s if lasted_s >= _LASTS_S else None,
        off_m=float(off_m[worst]),
        radius_m=float(radius_m[worst]),
        outside=float(np.mean(off_m > radius_m)),
        followed=cell != "jam" and lasted_s < _LASTS_S and bool(off_m[-1] > 0.5 * pulled_m),
    )


def _flight(name: str, seed: int) -> Flight:
    imu, gnss = Imu(rate_hz=50.0, grade="flight_controller"), Gnss(rate_hz=5.0)
    made = simulate(Scenario(duration_s=END_S, vehicle=SIMULATED[name], imu=imu, gnss=gnss, pose_fix=PoseFixes()), seed)
    truth = made.truth
    return Flight(made.messages, truth.t_ns, truth.p_n, truth.v_n, truth.R_nb, (), parse(made.config_toml, "simulated").fusion())


def _disturbed(flight: Flight, cell: str, fixes_s: float, seed: int, *, flagged: bool) -> Iterator[Input]:
    assert flight.config.origin is not None
    rng, origin, next_s = np.random.default_rng(seed), Origin(*flight.config.origin), ALIGNED_S + fixes_s
    for message in flight.messages:
        at_s = (message.t_ns - flight.start_ns) * 1e-9
        if isinstance(message, PoseFix) and at_s > ALIGNED_S:
            if not fixes_s or at_s < next_s:
                continue
            next_s += fixes_s
        elif isinstance(message, GnssFix | GnssVelocity) and at_s > FROM_S:
            if cell == "720 m" and at_s < FROM_S + BLACKOUT_S:
                continue
            yield _wrong(message, origin, cell, at_s - FROM_S, rng, flagged=flagged)
            continue
        yield message


def _wrong(
    message: GnssFix | GnssVelocity, origin: Origin, cell: str, since_s: float, rng: np.random.Generator, *, flagged: bool
) -> Input:
    speed = _SPEED_M_S.get(cell, 0.0)
    if isinstance(message, GnssVelocity):
        by: Array = _JAM_M_S * rng.standard_normal(3) if cell == "jam" else np.array([speed, 0.0, 0.0])
        return replace(message, v_n=vec3(np.array(message.v_n) + by))
    off = _OFF_M if cell == "720 m" else speed * since_s
    by = _JAM_M * rng.standard_normal(3) if cell == "jam" else np.array([off, 0.0, 0.0])
    place = origin.to_geodetic(np.array(origin.to_ned(message.lat_deg, message.lon_deg, message.alt_m)) + by)
    lat_deg, lon_deg, alt_m = place
    flag = (ReceiverState.JAMMED if cell == "jam" else ReceiverState.SPOOFED) if flagged else ReceiverState.UNKNOWN
    return replace(message, lat_deg=lat_deg, lon_deg=lon_deg, alt_m=alt_m, state=flag)


def table(rows: Sequence[Row]) -> Table:
    """A line for each cell: the latest reaction, the largest error and its radius, the largest share outside."""
    columns = "cell", "fixes each s", "flag", "flights", "reaction s", "left s", "worst m", "its radius m", "outside", "followed"
    cases = sorted({(CELLS.index(r.cell), r.fixes_s, r.flagged) for r in rows})
    return Table("A receiver's faults", columns, [_line([r for r in rows if _case(r) == case]) for case in cases])


def _case(row: Row) -> tuple[int, float, bool]:
    return CELLS.index(row.cell), row.fixes_s, row.flagged


def _line(rows: Sequence[Row]) -> tuple[str, ...]:
    first, worst = rows[0], max(rows, key=lambda r: r.off_m)
    return (
        first.cell,
        number(first.fixes_s) if first.fixes_s else "none",
        "yes" if first.flagged else "no",
        number(len(rows)),
        _latest([r.reaction_s for r in rows]),
        _latest([r.left_s for r in rows]),
        f"{worst.off_m:.1f}",
        f"{worst.radius_m:.1f}",
        f"{max(r.outside for r in rows):.1%}",
        f"{sum(r.followed for r in rows)} of {len(rows)}",
    )


def _latest(seconds: Sequence[float | None]) -> str:
    known = [s for s in seconds if s is not None]
    return f"{max(known):.1f}" if len(known) == len(seconds) else f"{len(known)} of {len(seconds)}"


def jobs(cells: Sequence[str]) -> list[Job]:
    """All flights of the cells; 105 returns after a blackout."""
    cases = [(c, f, flagged, name) for c in cells for f in FIXES_S for flagged in (False, True) for name in SIMULATED]
    found = [(*case, seed) for case in cases for seed in range(_SEEDS)]
    returns = [("720 m", f, False, name) for f, name in ((0.0, "rotor"), (0.0, "wing"), (20.0, "rotor"))]
    more = [(*case, seed) for case in returns for seed in range(_SEEDS, _RETURNS)]
    return found + (more if "720 m" in cells else [])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", nargs="+", choices=CELLS, default=CELLS, help=", ".join(CELLS))
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--resume", action="store_true", help="keep the rows of an earlier run that was ended")
    parser.add_argument("--rows", type=Path, default=ROOT / "out" / "receiver.jsonl", help="file of one JSON line a flight")
    args = parser.parse_args()
    rows = run_jobs(jobs(args.cells), run, Row, args.rows, processes=args.jobs, resume=args.resume)
    print(table(rows).markdown())


if __name__ == "__main__":
    main()
