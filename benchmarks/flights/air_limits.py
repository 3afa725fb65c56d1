"""Air data without GNSS: what limits them. When the dark begins, the filter is given the true value of one thing at a time.

    z = s_true,   H = I of the states s,   R -> 0: the error of s and what is correlated with it are gone, as of then

The rest of the drift is due to all other errors. With linear models and Gaussian errors the posterior covariance is the
Cramer-Rao bound of any filter with these sensors (Tichavsky, Muravchik and Nehorai 1998). So the radius that a consistent filter
reports is what is possible: sigma is given beside the error.

python -m benchmarks.flights.air_limits [-o FOLDER] [--jobs 2]
"""

import argparse
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.flights import air_data
from benchmarks.flights.air_data import Seconds
from benchmarks.tables import Table, number
from estimator.fusion import Fusion
from estimator.sources.air import drag
from estimator.sources.air.wind import WIND, estimated
from estimator.sources.base.aid import Aid, order
from estimator.sources.base.rules import Rules
from models.frames import Origin
from models.messages import Array
from models.sim.air import blow
from models.sim.scenario import Scenario, Simulation, simulate
from models.sim.trajectory import FixedWing, Multirotor
from models.state import E, local

AT_S: Final = 60
VEHICLES: Final[dict[str, Multirotor | FixedWing]] = {"multirotor": Multirotor(drag_1_s=0.15), "fixed wing": FixedWing()}
_RULES: Final = Rules(gate_probability=1.0 - 1e-15)
_SHARP: Final = {"attitude": 1e-5, "gyroscope's bias": 1e-7, "accelerometer's bias": 1e-5, "wind": 1e-3, "sensor": 1e-5}
_PARTS: Final = {"attitude": E.THETA, "gyroscope's bias": E.BG, "accelerometer's bias": E.BA}
_NO_STATES: Final = slice(0, 0)


WINDS_M_S: Final = (2.0, 4.0, 6.0, 8.0)
GIVEN: Final = {"nothing": (), **{part: (part,) for part in _SHARP}, "all of these": tuple(_SHARP)}


@dataclass(frozen=True, slots=True, eq=False)
class Given:
    """The states `at` of x (16,) are true, or a slow error is s (k,); sigma: of either."""

    x: Array
    at: slice
    s: Array
    sigma: float

    @property
    def noise(self) -> Array:
        """See Measurement."""
        return self.sigma**2 * np.eye(len(self.rows))

    @property
    def rows(self) -> NDArray[np.intp]:
        """See Measurement."""
        return np.arange(self.at.stop - self.at.start or len(self.s))

    def evaluate(self, x: Array, _: Array, /) -> tuple[Array, Array]:
        """nu = x_true (-) x; of a slow error s, from which its mean is taken later."""
        h = np.zeros((len(self.rows), E.SIZE))
        if self.at == _NO_STATES:
            return self.s.copy(), h
        h[:, self.at] = np.eye(len(self.rows))
        return local(x, self.x)[self.at], h


class _Truth(NamedTuple):
    """x (16,) when the dark begins, and the constants of wind and sensor, by block."""

    x: Array
    constants: dict[str, Array]


def _given(z: Given, _: Origin | None) -> Given:
    """The same whatever the origin."""
    return z


def _true(simulation: Simulation, made_of: Scenario, wind_m_s: float, begin_ns: int) -> _Truth:
    truth, k = simulation.truth, int(np.searchsorted(simulation.truth.t_ns, begin_ns))
    x = np.concatenate([truth.p_n[k], truth.v_n[k], truth.q_nb_wxyz[k], truth.gyro_bias[k], truth.accel_bias[k]])
    rng = np.random.default_rng(air_data.seed_of(wind_m_s)).spawn(5)[4]  # as models.sim.scenario.simulate draws
    assert made_of.wind is not None
    wind_n = blow(made_of.wind, rng).mean_n
    if made_of.airspeed is None:
        return _Truth(x, {WIND: wind_n, f"{drag.TOPIC}.tilt": np.zeros(2), f"{drag.TOPIC}.scale": np.zeros(1)})
    scale = made_of.airspeed.scale_sigma * rng.standard_normal(1)
    return _Truth(x, {WIND: wind_n, "/airspeed.scale": scale})


def _aids(true: _Truth, parts: Sequence[str], t_ns: int) -> Iterator[Aid]:
    """What gives the filter the true values."""
    for part in parts:
        names = [WIND] if part == "wind" else [b for b in true.constants if b != WIND] if part == "sensor" else [part]
        for name in names:
            at, s = _PARTS.get(name, _NO_STATES), true.constants.get(name, np.zeros(0))
            slow = () if name in _PARTS else (estimated(name, np.ones(len(s)), np.eye(len(s))),)
            z = Given(true.x, at, s, _SHARP[part])
            yield Aid(
                t_ns=t_ns,
                arrived_ns=t_ns,
                topic=name,
                kind="true",
                order=order(t_ns, "true", name),
                rules=_RULES,
                absolute=False,
                log_false=-1e3,
                measurement=partial(_given, z),
                slow_errors=slow,
                weighs=False,
            )


def windows(job: tuple[str, float]) -> dict[str, Seconds]:
    """The dark minute of a flight, by what the filter is given. job: vehicle and wind, m/s."""
    name, wind_m_s = job
    made_of = air_data.scenario(VEHICLES[name], wind_m_s, vibrates=True)
    simulation = simulate(made_of, air_data.seed_of(wind_m_s))
    flight = air_data.flight_of(simulation, vibrates=True)
    begin_ns = flight.begins_ns[0]
    true = _true(simulation, made_of, wind_m_s, begin_ns)
    last_ns = begin_ns + (AT_S + 1) * 1_000_000_000
    flight = flight._replace(messages=[m for m in flight.messages if m.t_ns < last_ns])
    first = next(k for k, m in enumerate(flight.messages) if m.t_ns >= begin_ns)
    fusion, found = Fusion(flight.config.fusion()), {}
    for message in flight.messages[:first]:
        fusion.handle(message)
    for case, parts in GIVEN.items():
        dark = deepcopy(fusion)
        for aid in _aids(true, parts, begin_ns):
            dark._history.insert_aid(aid)
        found[case] = air_data.dark(dark, flight, first, begin_ns)
    return found


def table(processes: int) -> Table:
    """A row for each vehicle and what its filter is given."""
    jobs = [(name, wind) for name in VEHICLES for wind in WINDS_M_S]
    found: dict[tuple[str, str], list[Seconds]] = {}
    with ProcessPoolExecutor(processes) as pool:
        for job, cases in zip(jobs, pool.map(windows, jobs), strict=True):
            print(*job, *(f"{case}: {number(float(w.error_m[AT_S]))} m;" for case, w in cases.items()), flush=True)
            for case, window in cases.items():
                found.setdefault((job[0], case), []).append(window)
    rows = []
    for (name, case), seconds in found.items():
        errors, sigmas = (np.array([getattr(w, key)[AT_S] for w in seconds]) for key in ("error_m", "sigma_m"))
        figures = float(np.median(errors)), float(np.sqrt(np.mean(errors**2))), float(np.sqrt(np.mean(sigmas**2)))
        inside = np.mean([w.nees[1 : AT_S + 1] < air_data.INSIDE95 for w in seconds])
        rows.append((name, case, *map(number, figures), f"{100.0 * inside:.0f}"))
    columns = ("flight", "given", "median m", "rms m", "predicted rms m", "in 95 %")
    return Table(f"{AT_S} s without GNSS in winds of 2 to 8 m/s: horizontal error, and what the filter predicts", columns, rows)


def main() -> None:
    """The table, on the terminal and in a file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=Path("out/air_data"), help="folder of the results")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    text = table(given.jobs).markdown()
    (given.out / "air_limits.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
