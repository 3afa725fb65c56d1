"""A public ArduPilot flight with three IMUs, of 50 Hz: the first leads to the end; where it fails, the second takes over."""

from pathlib import Path

import numpy as np
import pytest

from estimator.config import parse
from estimator.fusion import Fusion
from logs.importers import dataflash
from models.messages import Estimate, GnssFix, GnssVelocity, ImuSample, Input
from models.state import E, X
from tests.estimator.scenes import Run

FAULT_S, DARK_S = 145.0, (142.0, 160.0)


@pytest.fixture(scope="module")
def flight(landfix_data: Path) -> tuple[str, list[Input]]:
    log = landfix_data / "native_logs" / "ardupilot_log171.bin"
    if not log.exists():
        pytest.skip("needs LANDFIX_DATA/native_logs/ardupilot_log171.bin")
    recording = dataflash.read(log)
    topics = tuple(s.topic for s in recording.streams if s.topic != "/truth")
    messages = [m for s in recording.streams if s.topic != "/truth" for m in s]
    return recording.settings.toml("dataflash", log, topics), sorted(messages, key=lambda m: m.arrived_ns)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def whole(flight: tuple[str, list[Input]]) -> Run:
    text, messages = flight
    return Run(Fusion(parse(text).fusion())).feed(messages)


def _seconds(message: Input | Estimate, first: Input) -> float:
    return (message.t_ns - first.t_ns) * 1e-9


@pytest.mark.long
def test_given_three_imus_that_vibrate_then_none_is_taken_for_wrong(whole: Run) -> None:
    assert [s for s in whole.statuses if s.kind == "imu"] == []
    assert {whole.health[-1].sources[t] for t in ("/imu2", "/imu3")} == {"standby"}


@pytest.mark.long
def test_given_the_first_falls_silent_in_the_dark_then_the_second_goes_on_from_there(
    flight: tuple[str, list[Input]], whole: Run
) -> None:
    text, messages = flight
    first = messages[0]
    until_then = [m for m in messages if _seconds(m, first) < FAULT_S + 12.0]
    lit = [m for m in until_then if not (isinstance(m, GnssFix | GnssVelocity) and DARK_S[0] < _seconds(m, first) < DARK_S[1])]
    failed = [m for m in lit if not (isinstance(m, ImuSample) and m.topic == "/imu" and _seconds(m, first) > FAULT_S)]
    reference = {e.t_ns: e for e in whole.estimates}
    run = Run(Fusion(parse(text).fusion())).feed(failed)
    (change,) = [s for s in run.statuses if s.kind == "imu"]
    assert "/imu is silent; /imu2 leads" in change.detail
    dark = [e for e in run.estimates if FAULT_S + 0.5 < _seconds(e, first) < FAULT_S + 10.0 and e.t_ns in reference]
    assert len(dark) > 300
    off = np.array([e.nav[X.P] - reference[e.t_ns].nav[X.P] for e in dark])
    sigma = np.array([np.sqrt(np.trace(e.covariance[E.P, E.P])) for e in dark])
    assert (np.linalg.norm(off, axis=1) / sigma).max() < 2.0
