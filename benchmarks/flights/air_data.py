"""Air data: GNSS hidden, no images. What airspeed, the drag of a multirotor and an estimated wind are worth.

    e: horizontal position error,   NEES = e' P^-1 e / 2,   in 95 %: share of seconds inside the ellipse

python -m benchmarks.flights.air_data [-o FOLDER]: a recorded fixed wing (umn_thor75, against its autopilot's estimate with
GNSS), simulated multirotors and fixed wings in winds of 1 to 8 m/s. The flight before the dark is gone through once; each
window goes on from a copy.
"""

import argparse
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np

from benchmarks.flights import gnss
from benchmarks.tables import Table, number
from estimator.config import Config, parse
from estimator.fusion import Fusion
from logs.evaluation.metrics import Times
from logs.importers.recording import Truth
from models.messages import Array, Estimate, GnssFix, GnssVelocity, Input, Reading
from models.sim.aids import Gnss
from models.sim.air import Airspeed, Wind
from models.sim.scenario import EPOCH_NS, Scenario, Simulation, simulate
from models.sim.sensors import Imu
from models.sim.trajectory import FixedWing, Multirotor
from models.state import E, X

LENGTHS_S: Final = (30, 60, 120)
WINDS_M_S: Final = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0)
INSIDE95: Final = 5.991465  # chi-square, 2 degrees of freedom
_VIBRATION: Final = 20.0  # times the data sheet's noise
_LIT_S: Final = 120.0
_SECOND_NS: Final = 1_000_000_000
_THOR_BEGINS_S: Final = tuple(range(300, 431, 10))  # of the log; airborne from 190 to 558 s
_LEVEL: Final = slice(0, 2)
_COLUMNS: Final = ("flight", "with", "windows", *(f"{s} s: median, worst m" for s in LENGTHS_S), "NEES/2", "in 95 %")
FLIGHTS: Final = ("umn_thor75", "multirotor", "multirotor, quiet IMU", "fixed wing")

Change = Callable[[Config], Config]


class Flight(NamedTuple):
    """messages in order of arrival; true t_ns (n,) and p_n (n, 3); begins of the dark, ns; how it is configured."""

    messages: Sequence[Input]
    t_ns: Times
    p_n: Array
    begins_ns: Sequence[int]
    config: Config


class Seconds(NamedTuple):
    """A window, by seconds since its begin: size of the error [m], its NEES and its predicted rms sqrt(tr P) [m], each (n,)."""

    error_m: Array
    nees: Array
    sigma_m: Array


def run(flight: Flight, config: Config) -> list[Seconds]:
    """Every window of a flight."""
    begins, windows = sorted(flight.begins_ns), []
    fusion, at = Fusion(config.fusion()), 0
    for k, message in enumerate(flight.messages):
        if at < len(begins) and message.t_ns >= begins[at]:
            windows.append(dark(deepcopy(fusion), flight, k, begins[at]))
            at += 1
        if at == len(begins):
            break
        fusion.handle(message)
    return windows


def dark(fusion: Fusion, flight: Flight, first: int, begin_ns: int) -> Seconds:
    """From a message on, without GNSS."""
    errors: list[float] = []
    ratios: list[float] = []
    sigmas: list[float] = []
    for message in flight.messages[first:]:
        if message.t_ns > begin_ns + (LENGTHS_S[-1] + 1) * _SECOND_NS or len(errors) > LENGTHS_S[-1]:
            break
        if isinstance(message, GnssFix | GnssVelocity):
            continue
        for out in fusion.handle(message):
            if isinstance(out, Estimate) and out.t_ns >= begin_ns + len(errors) * _SECOND_NS:
                true = [np.interp(out.t_ns - begin_ns, flight.t_ns - begin_ns, flight.p_n[:, axis]) for axis in (0, 1)]
                off, cov = out.nav[X.P][_LEVEL] - true, out.covariance[E.P, E.P][_LEVEL, _LEVEL]
                errors.append(float(np.linalg.norm(off)))
                ratios.append(float(off @ np.linalg.solve(cov, off)))
                sigmas.append(float(np.sqrt(np.trace(cov))))
    return Seconds(np.array(errors), np.array(ratios), np.array(sigmas))


def thor(out: Path) -> Flight:
    """A recorded fixed wing in a wind of 6 m/s with gusts of 1.4 m/s."""
    recording, config = gnss.flight("umn_thor75", out)
    truth = [m for m in recording if isinstance(m, Truth)]
    messages = gnss.inputs(recording)
    begins = [messages[0].t_ns + s * _SECOND_NS for s in _THOR_BEGINS_S]
    return Flight(messages, np.array([m.t_ns for m in truth], np.int64), np.array([m.p_n for m in truth]), begins, config)


def scenario(vehicle: Multirotor | FixedWing, wind_m_s: float, *, vibrates: bool, gusts: bool = True) -> Scenario:
    """Two minutes with GNSS and two without; gusts of a sixth of the wind. vibrates: the IMU, as [imu] says by default."""
    return Scenario(
        duration_s=_LIT_S + LENGTHS_S[-1] + 2.0,
        vehicle=vehicle,
        imu=Imu(grade="hobby", rate_hz=100.0, noise_multiplier=_VIBRATION if vibrates else 1.0),
        gnss=Gnss(rate_hz=5.0),
        wind=Wind(speed_m_s=wind_m_s, gust_m_s=wind_m_s / 6.0 if gusts else 0.0, gust_s=5.0),
        airspeed=Airspeed() if isinstance(vehicle, FixedWing) else None,
    )


def flight_of(simulation: Simulation, *, vibrates: bool) -> Flight:
    """What was simulated, and how it is configured."""
    begin = [EPOCH_NS + round(_LIT_S * _SECOND_NS)]
    config = parse(simulation.config_toml)
    if vibrates:
        config = msgspec.structs.replace(config, imu=Config().imu)
    return Flight(simulation.messages, simulation.truth.t_ns, simulation.truth.p_n, begin, config)


def simulated(vehicle: Multirotor | FixedWing, wind_m_s: float, *, vibrates: bool) -> Flight:
    """A flight in this wind, which is its seed too."""
    return flight_of(simulate(scenario(vehicle, wind_m_s, vibrates=vibrates), seed_of(wind_m_s)), vibrates=vibrates)


def seed_of(wind_m_s: float) -> int:
    """Of a simulated flight."""
    return round(10 * wind_m_s)


def _without_airspeed(config: Config) -> Config:
    return msgspec.structs.replace(config, inputs=msgspec.structs.replace(config.inputs, airspeed=()))


def _drag(enabled: bool) -> Change:
    return lambda c: msgspec.structs.replace(c, drag=msgspec.structs.replace(c.drag, enabled=enabled))


def _calm(config: Config) -> Config:
    """The air taken to stand still."""
    return msgspec.structs.replace(config, wind=msgspec.structs.replace(config.wind, sigma_m_s=0.1, walk_m_s_sqrt_s=1e-4))


def _slips(deg: float) -> Change:
    return lambda c: msgspec.structs.replace(c, airspeed=msgspec.structs.replace(c.airspeed, sideslip_deg=deg))


def _same(config: Config) -> Config:
    return config


_FIXED_WING: Final[dict[str, Change]] = {
    "IMU alone": _without_airspeed,
    "airspeed, wind": _same,
    "airspeed, wind, sideslip of 4 deg": _slips(4.0),
    "airspeed, taken for calm air": _calm,
}
_MULTIROTOR: Final[dict[str, Change]] = {
    "IMU alone": _drag(enabled=False),
    "drag, wind": _same,
    "drag, taken for calm air": _calm,
}
ARMS: Final = {name: _MULTIROTOR if name.startswith("multirotor") else _FIXED_WING for name in FLIGHTS}


def arm(name: str, change: str, out: Path) -> tuple[str, ...]:
    """A line of the table."""
    if name == "umn_thor75":
        flights = [thor(out)]
    else:
        vehicle = FixedWing() if name == "fixed wing" else Multirotor(drag_1_s=0.15)
        flights = [simulated(vehicle, wind, vibrates="quiet" not in name) for wind in WINDS_M_S]
    windows = []
    for flight in flights:
        config = ARMS[name][change](flight.config)
        kinds = {"airspeed"} if not config.inputs.airspeed else set()
        shown = [m for m in flight.messages if not (isinstance(m, Reading) and m.kind in kinds)]
        windows += run(flight._replace(messages=shown), config)
    cells = []
    for length in LENGTHS_S:
        ends = [w.error_m[length] for w in windows if len(w.error_m) > length]
        cells.append(f"{number(float(np.median(ends)))}, {number(max(ends))} ({len(ends)})" if ends else "-")
    nees = np.concatenate([w.nees[1:] for w in windows])
    return (name, change, str(len(windows)), *cells, number(float(nees.mean() / 2.0)), f"{100.0 * np.mean(nees < INSIDE95):.0f}")


def table(out: Path, processes: int, names: Sequence[str] = FLIGHTS) -> Table:
    """All lines."""
    jobs = [(name, change) for name in names for change in ARMS[name]]
    with ProcessPoolExecutor(processes) as pool:
        futures = [pool.submit(arm, name, change, out) for name, change in jobs]
        rows = []
        for job, future in zip(jobs, futures, strict=True):
            rows.append(future.result())
            print(", ".join(job), "done", flush=True)
    return Table("GNSS hidden for 120 s: horizontal error after 30, 60 and 120 s (windows that last so long)", _COLUMNS, rows)


def main() -> None:
    """The table, on the terminal and in a file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=Path("out/air_data"), help="folder of the results")
    parser.add_argument("--only", nargs="+", choices=FLIGHTS, default=FLIGHTS, help="flights; default: all")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    text = table(given.out, given.jobs, given.only).markdown()
    (given.out / "air_data.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
