"""Where estimate and reference differ, the record says with which of them the receiver agrees."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from logs.evaluation.agreement import contradiction
from logs.evaluation.collected import Collected, Fixes, read
from logs.evaluation.evaluate import assess
from models.messages import AidStatus, Array, Reason
from tests.logs import flight_log


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Collected:
    """Of 10 s, with a receiver that is 0.5 m off."""
    path: Path = tmp_path_factory.mktemp("agreement") / "short.mcap"
    flight_log.write(path, flight_log.Flight(duration_s=10.0, outages=()))
    collected = read(path)
    rows = slice(0, None, 10)
    t_ns = collected.truth.t_ns[rows]
    p = collected.truth.p[rows] + np.random.default_rng(1).normal(0.0, 0.5, (len(t_ns), 3))
    gnss = AidStatus(int(t_ns[0]), int(t_ns[0]), "/gnss", "gnss_position", Reason.FUSED)
    return replace(
        collected, fixes={"/gnss": Fixes(t_ns, p, np.ones(len(t_ns), bool))}, aids=(gnss,), reference="another estimate"
    )


def _off(flight: Collected, name: str, by: Array) -> Collected:
    trajectory = getattr(flight, name)
    return replace(flight, **{name: replace(trajectory, p=trajectory.p + by)})


def test_all_alike_nothing_is_said(flight: Collected) -> None:
    assert contradiction(flight) == ""


def test_a_reference_that_the_receiver_contradicts(flight: Collected) -> None:
    found = contradiction(_off(flight, "truth", np.array([12.0, 0.0, 0.0])))
    assert found.startswith("reference or landfix: /gnss agrees with landfix: its median distance is 0.")
    assert found.endswith("m from the reference")


def test_an_estimate_that_the_receiver_contradicts(flight: Collected) -> None:
    off = replace(_off(flight, "estimate", np.array([12.0, 0.0, 0.0])), reference="")
    assert contradiction(off).startswith("truth or landfix: /gnss agrees with the truth: its median distance is 1")
    assert contradiction(off) in assess(off, "short").notes


def test_a_difference_of_height_or_a_receiver_that_is_off_from_both_says_nothing(flight: Collected) -> None:
    assert contradiction(_off(flight, "truth", np.array([0.0, 0.0, 30.0]))) == ""
    fixes = flight.fixes["/gnss"]
    assert contradiction(replace(flight, fixes={"/gnss": fixes.__class__(fixes.t_ns, fixes.p + 40.0, fixes.used)})) == ""
