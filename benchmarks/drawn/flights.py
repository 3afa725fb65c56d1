"""A flight of a seed: manoeuvres, sources, outage and faults drawn from it; flown, its levels and its lock-out measured."""

from hashlib import sha256
from typing import Final, TypeAlias

import msgspec
import numpy as np

from benchmarks.drawn.alerts import cautions
from benchmarks.drawn.faults import Fault, drawn, log_uniform, with_faults
from benchmarks.drawn.lockout import Lockout, lockout
from benchmarks.drawn.rates import Flown
from benchmarks.flights.tasks import ROOT
from benchmarks.integrity.runs import compared, flown, village
from benchmarks.stress.flights import Flight
from benchmarks.stress.perturbations import Rng
from estimator.tools.fleet.flight import code
from models.sim.trajectory import FixedWing, Multirotor

Job: TypeAlias = tuple[int, float, str]  # seed, seconds, program: rows of another one are made anew

_GENERATOR: Final = ("benchmarks/drawn/faults.py", "benchmarks/drawn/flights.py", "benchmarks/stress/perturbations.py")
_BOTH: Final = 0.5  # share of the flights with GNSS and fixes; the others have fixes alone
_RATES_HZ: Final = (0.5, 2.0)  # of fixes
_OUTAGE: Final = 0.3  # share of the flights with one
_OUTAGE_S: Final = (4.0, 20.0)


def program() -> str:
    """sha256 of the estimator and of what draws the flights."""
    return sha256(code().encode() + b"".join((ROOT / file).read_bytes() for file in _GENERATOR)).hexdigest()[:16]


def fly(job: Job) -> Flown:
    """The flight of a seed: vehicle and manoeuvres, sources, faults, all drawn from it."""
    seed, seconds, made_by = job
    rng = np.random.default_rng([seed, 17])
    aids = "both" if rng.random() < _BOTH else "fixes"
    vehicle, flight = _flight(rng, aids, seconds, seed)
    faults, weight = drawn(rng, aids, seconds)
    messages = with_faults(flight, faults, rng)
    estimates, levels = flown(flight, messages)
    spans = [(flight.start_ns + round(f.from_s * 1e9), flight.start_ns + round(f.to_s * 1e9)) for f in faults]
    row = compared(flight, estimates, levels)
    row = msgspec.structs.replace(row, group="drawn", flight=vehicle, kind=_said(faults), size=seconds, seed=seed)
    locked: Lockout | None = lockout(flight, faults, messages, estimates)
    return Flown(seed, made_by, vehicle, aids, seconds, faults, weight, row, cautions(levels, spans), locked)


def _said(faults: tuple[Fault, ...]) -> str:
    return ", ".join(map(str, faults))


def _flight(rng: Rng, aids: str, seconds: float, seed: int) -> tuple[str, Flight]:
    """Speed, hovering, climb, bank and height are drawn, too."""
    height_m = log_uniform(rng, 15.0, 150.0)
    vehicle: Multirotor | FixedWing
    if rng.random() < 0.5:
        name, speed_m_s = "rotor", log_uniform(rng, 2.0, 15.0)
        climb_m_s, hover_share = float(rng.uniform(0.5, 4.0)), float(rng.uniform(0.0, 0.6))
        vehicle = Multirotor(speed_m_s=speed_m_s, climb_m_s=climb_m_s, hover_share=hover_share, height_m=height_m, seed=seed)
    else:
        name, bank_deg, climb_m_s = "wing", float(rng.uniform(10.0, 50.0)), float(rng.uniform(0.0, 6.0))
        vehicle = FixedWing(bank_deg=bank_deg, climb_m_s=climb_m_s, height_m=100.0 + height_m, seed=seed)
    rate_hz = float(rng.choice(_RATES_HZ))
    begin_s = float(rng.uniform(0.0, seconds))
    outages = ((begin_s, begin_s + float(rng.uniform(*_OUTAGE_S))),) if rng.random() < _OUTAGE else ()
    return f"{name} {rate_hz:g} Hz" + (" outage" if outages else ""), village(vehicle, aids, seconds, seed, rate_hz, outages)
