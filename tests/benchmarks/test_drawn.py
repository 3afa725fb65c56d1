"""Drawn faults: weights that are right, windows that are kept, arithmetic that a reader can follow."""

import math

import msgspec
import numpy as np
import pytest

from benchmarks.drawn.__main__ import compared
from benchmarks.drawn.alerts import alerts, in_time_or_covered
from benchmarks.drawn.faults import KINDS, Fault, drawn, kinds_of, nominal, with_faults, within
from benchmarks.drawn.lockout import locked_s
from benchmarks.drawn.rates import AIDS, NONE, SEVERAL, UNBOUNDED, Flown, probabilities, rate
from benchmarks.integrity.report import bound
from benchmarks.integrity.rows import Row
from benchmarks.integrity.runs import village
from estimator.integrity.config import IntegrityConfig
from models.sim.trajectory import Multirotor

SECONDS = 120.0


def flown(seed: int, faults: tuple[Fault, ...], weight: float, events: int) -> Flown:
    return Flown(seed, "", "rotor", "both", SECONDS, faults, weight, Row("drawn", "rotor", "", SECONDS, seed, misled=events))


@pytest.mark.parametrize("aids", AIDS)
def test_the_weighted_share_of_each_kind_is_its_nominal_probability(aids: str) -> None:
    rng = np.random.default_rng(1)
    draws = [drawn(rng, aids, SECONDS) for _ in range(20_000)]
    assert 0.9 < np.mean([len(faults) for faults, _ in draws]) < 1.1
    assert np.mean([weight for _, weight in draws]) == pytest.approx(1.0, abs=0.03)
    for kind in kinds_of(aids):
        share = np.mean([weight * any(f.kind == kind for f in faults) for faults, weight in draws])
        assert share == pytest.approx(nominal(kind, aids, SECONDS), rel=0.25)
    of_one = [f for faults, _ in draws for f in faults if f.kind == "map shift"]
    assert np.mean([f.bounded(aids) for f in of_one]) == pytest.approx(within("map shift", aids), abs=0.05)


@pytest.mark.parametrize("aids", AIDS)
def test_the_strata_are_all_there_is(aids: str) -> None:
    found = probabilities(aids, SECONDS)
    assert math.fsum(found.values()) == pytest.approx(1.0, abs=1e-15)
    assert found[NONE] > 1.0 - 3e-5
    assert 0.0 <= found[SEVERAL] < 1e-9
    assert ("map" + UNBOUNDED in found) is (aids == "fixes")
    rate = sum(p for name, p in found.items() if name.startswith("map")) * 3600.0 / SECONDS
    assert rate == pytest.approx(IntegrityConfig().map_fault_per_hour, rel=1e-4)


def test_a_fault_changes_messages_while_it_lasts_and_no_others() -> None:
    flight = village(Multirotor(seed=3), "both", 40.0, 3)
    rng = np.random.default_rng(1)
    for name, kind in KINDS.items():
        messages = with_faults(flight, (Fault(name, kind.sizes[1], 12.0, 20.0),), rng)
        before, after = ({repr(m) for m in some} for some in (flight.messages, messages))
        lost = [m for m in flight.messages if repr(m) not in after]
        assert lost, name
        assert all(12.0 <= (m.t_ns - flight.start_ns) * 1e-9 < 20.0 for m in lost), name
        assert len(after - before) == (0 if name == "IMU samples lost" else len(lost)), name


def test_a_lock_out_is_from_the_last_faulty_reading_until_the_error_stays_small() -> None:
    t_s, off = np.arange(0.0, 20.0, 0.1), np.zeros(200)
    off[50:80] = 5.0  # 5 s to 8 s
    off[90:91] = 5.0
    assert locked_s(t_s, off, 1.0, 6.0) == pytest.approx(3.1)
    off[100:] = 5.0
    assert locked_s(t_s, off, 1.0, 12.0) is None


def test_rates_are_the_arithmetic_of_the_strata() -> None:
    (kind, *_) = KINDS
    fault = Fault(kind, 1.0, 10.0, 20.0)
    cause, p = KINDS[kind].cause, nominal(kind, "both", SECONDS)
    of_cause = sum(nominal(k, "both", SECONDS) for k in KINDS if KINDS[k].cause == cause)
    some = [flown(k, (), 2.5, 0) for k in range(60)] + [flown(k, (fault,), 16.0 * p, k == 60) for k in range(60, 100)]
    found = rate(some)
    assert found.per_hour == pytest.approx(16.0 * p / 100 * 30.0)
    by_name = {s.name: s for s in found.strata}
    assert (by_name[cause].flights, by_name[cause].with_event) == (40, 1)
    assert by_name[cause].per_hour == pytest.approx(of_cause * bound(1, 40) * 30.0, rel=1e-4)
    assert by_name[SEVERAL].share_at_most == 1.0  # never drawn
    assert 60.0 < found.ess < 61.0


def test_another_program_is_compared_over_the_same_flights() -> None:
    (kind, *_) = KINDS
    fault = (Fault(kind, 1.0, 10.0, 20.0),)
    done = [flown(k, fault, 1.0, k == 3) for k in range(4)]
    before = [msgspec.structs.replace(flown(k, fault, 1.0, k in {2, 3, 9}), program="before") for k in (1, 2, 3, 9)]
    (mine, theirs) = compared(done, [*done, *before]).rows
    assert mine[:4] == ("", "4", "3", "3")
    assert theirs[:4] == ("before", "3", "2, 3", "3")


def test_alerts_are_counted_by_kind_and_false_ones_by_the_hour() -> None:
    (first, second, *_) = KINDS
    quiet = flown(0, (), 2.5, 0)
    late = flown(1, (Fault(first, 1.0, 10.0, 20.0), Fault(second, 1.0, 12.0, 30.0)), 1.0, 1)
    late = msgspec.structs.replace(
        late, cautions_s=(3.0, None), row=msgspec.structs.replace(late.row, alerts_s=(0.4, 1.6), hours=0.5, false_alerts=2)
    )
    by_kind = {a.kind: a for a in alerts([quiet, late])}
    assert set(by_kind) == {f"{NONE}, rotor", first, second}
    assert (by_kind[first].passed, by_kind[first].alerted, by_kind[first].covered) == (2, 1, 0)
    assert (by_kind[first].caution_s, by_kind[second].caution_s, by_kind[first].false_per_hour) == (3.0, None, 4.0)
    assert in_time_or_covered([quiet, late]) == (0, 2)
    in_time = msgspec.structs.replace(late, row=msgspec.structs.replace(late.row, alerts_s=(0.4, 0.6)))
    assert in_time_or_covered([quiet, in_time]) == (2, 2)
