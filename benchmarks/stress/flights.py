"""Flights to perturb: recorded ones with fixes made from the truth, and short simulated ones; messages, truth, configuration.

aids "fixes": pose fixes at 2 Hz with outages;  "both": pose fixes and GNSS throughout;  "gnss": GNSS, fixes for the first 10 s
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from benchmarks.flights.tasks import SETS, Task, flights, make, read_odometry
from estimator.config import load, parse
from estimator.fusion import FusionConfig
from logs.evaluation.metrics import rotation
from logs.store.reader import LogReader
from logs.wire.codec import Decoder, ImuMounting, Topics
from models.frames import ENU_FROM_NED, FLU_FROM_FRD, Origin
from models.messages import Array, GnssFix, GnssVelocity, Input, PoseFix, vec3
from models.sim.aids import Gnss, PoseFixes
from models.sim.faults import in_order
from models.sim.ranges import Interval
from models.sim.scenario import Scenario, simulate
from models.sim.sensors import Imu
from models.sim.trajectory import FixedWing, Multirotor

Aids = Literal["fixes", "both", "gnss"]
SIMULATED: dict[str, Multirotor | FixedWing] = {"rotor": Multirotor(seed=0), "wing": FixedWing(seed=0)}
SIMULATED_S, SIMULATED_OUTAGE_S = 70.0, (40.0, 50.0)
ALIGNED_S = 10.0  # aids "gnss": fixes until then
_ORIGIN = Scenario().origin  # where recorded flights are put on Earth, so that they can have GNSS
_RECEIVER = Gnss()
_HALF_S = 0.2  # velocities are differences of positions so long before and after
_NEAR_NS = 20_000_000  # a measurement is made from a truth that near


@dataclass(frozen=True, slots=True)
class Flight:
    """Messages in order of arrival; truth at t_ns (n,): p_n, v_n (n, 3), R_nb (n, 3, 3); outages [s] from the first message."""

    messages: list[Input]
    t_ns: NDArray[np.int64]
    p_n: Array
    v_n: Array
    R_nb: Array
    outages_s: tuple[Interval, ...]
    config: FusionConfig

    @property
    def start_ns(self) -> int:
        """Of the flight: the first message."""
        return self.messages[0].t_ns

    def row(self, t_ns: int) -> int:
        """Of the truth, the nearest to t_ns."""
        k = int(np.clip(np.searchsorted(self.t_ns, t_ns), 1, len(self.t_ns) - 1))
        return k - int(t_ns - self.t_ns[k - 1] < self.t_ns[k] - t_ns)


def names(*, quick: bool) -> list[str]:
    """Of the flights: a simulated one for a quick run, else the simulated and the recorded ones, as set/flight."""
    if quick:
        return ["sim/rotor"]
    return [f"sim/{name}" for name in SIMULATED] + [f"{group}/{flight}" for group in SETS for flight in flights(group)]


def load_flight(name: str, aids: Aids, seed: int, tasks: Path) -> Flight:
    """The flight, unperturbed. tasks: folder where the MCAP files of recorded flights are kept."""
    group, flight = name.split("/")
    made = _simulated(flight, aids, seed) if group == "sim" else _recorded(group, flight, aids, seed, tasks)
    if aids != "gnss":
        return made
    aligned_ns = made.start_ns + round(ALIGNED_S * 1e9)
    kept = [m for m in made.messages if not isinstance(m, PoseFix) or m.t_ns <= aligned_ns]
    return Flight(kept, made.t_ns, made.p_n, made.v_n, made.R_nb, made.outages_s, made.config)


def _simulated(name: str, aids: Aids, seed: int) -> Flight:
    outages = (SIMULATED_OUTAGE_S,) if aids == "fixes" else ()
    scenario = Scenario(
        duration_s=SIMULATED_S,
        vehicle=SIMULATED[name],
        imu=Imu(rate_hz=100.0),
        gnss=None if aids == "fixes" else _RECEIVER,
        pose_fix=PoseFixes(outages_s=outages),
    )
    made = simulate(scenario, seed)
    truth = made.truth
    config = parse(made.config_toml, "simulated").fusion()
    return Flight(made.messages, truth.t_ns, truth.p_n, truth.v_n, truth.R_nb, outages, config)


def _recorded(group: str, name: str, aids: Aids, seed: int, tasks: Path) -> Flight:
    """Scenario A (outages) or N of the scoring tool; a flight too short for the outages has none."""
    flight = of_task(Task(group, name, "A", seed), tasks) if aids == "fixes" else None
    flight = flight or of_task(Task(group, name, "N", seed), tasks)
    if flight is None:
        raise SystemExit(f"{group}/{name}: no task can be made of it")
    if aids == "fixes":
        return flight
    with_gnss = in_order([*_received(flight, np.random.default_rng(seed)), *flight.messages])
    placed = msgspec.structs.replace(flight.config, origin=_ORIGIN)
    return Flight(with_gnss, flight.t_ns, flight.p_n, flight.v_n, flight.R_nb, flight.outages_s, placed)


def of_task(task: Task, tasks: Path) -> Flight | None:
    """A flight of the scoring tool; None where it is too short for the scenario. tasks: folder where the MCAP files are kept."""
    path = make(task, tasks)
    if path is None:
        return None
    config = load(path.with_suffix(".toml"))
    decoder = Decoder(Topics.of(msgspec.to_builtins(config.inputs)), ImuMounting(axes="flu"))
    messages: list[Input] = []
    with LogReader(path) as reader:
        for record in reader:
            message = decoder.decode(record.topic, record.schema, record.data, record.log_time_ns)
            if message is not None:
                messages.append(message)
    enu = read_odometry(path, "/truth")
    R_nb = ENU_FROM_NED.T @ rotation(enu.q_wxyz).as_matrix() @ FLU_FROM_FRD
    outages = tuple((float(a), float(b)) for a, b in json.loads(path.with_suffix(".json").read_text())["outages"])
    return Flight(messages, enu.t_ns, enu.p @ ENU_FROM_NED.T, enu.v @ ENU_FROM_NED.T, R_nb, outages, config.fusion())


def _received(flight: Flight, rng: np.random.Generator) -> list[Input]:
    """Position and velocity of a receiver at the body, with the white noise of models.sim.aids.Gnss.

    The velocity is the slope of the true positions: the recorded one of the quad set disagrees with its heights by 0.3 m/s.
    """
    t_s = (flight.t_ns - flight.start_ns) * 1e-9
    after, before = np.minimum(t_s + _HALF_S, t_s[-1]), np.maximum(t_s - _HALF_S, t_s[0])
    moved = [np.interp(after, t_s, p) - np.interp(before, t_s, p) for p in flight.p_n.T]
    slope = np.stack(moved, axis=1) / (after - before)[:, None]
    origin, found = Origin(*_ORIGIN), list[Input]()
    P, V = (np.diag(np.square(sigma)) for sigma in (_RECEIVER.sigma_m, _RECEIVER.velocity_sigma_m_s))
    for wanted in np.arange(flight.t_ns[0], flight.t_ns[-1], round(1e9 / _RECEIVER.rate_hz)):
        k = flight.row(int(wanted))
        t_ns = int(flight.t_ns[k])
        if abs(t_ns - wanted) > _NEAR_NS:
            continue
        p_n = flight.p_n[k] + _RECEIVER.sigma_m * rng.standard_normal(3)
        v_n = slope[k] + _RECEIVER.velocity_sigma_m_s * rng.standard_normal(3)
        found += [GnssFix(t_ns, t_ns, *origin.to_geodetic(p_n), P), GnssVelocity(t_ns, t_ns, vec3(v_n), V)]
    return found
