"""What `landfix run` says of inputs that are missing or broken: once each."""

from pathlib import Path

import pytest

from estimator.service import console as module
from estimator.service.console import Console
from models.messages import AidStatus, Health, Mode, Reason

S = 10**9


def _health(s: float, mode: Mode, detail: str = "") -> Health:
    t_ns = 1000 * S + round(s * S)
    return Health(t_ns, t_ns, mode, float("inf"), float("inf"), 180.0, 0, {}, {}, 0, detail=detail)


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    lines: list[str] = []
    monkeypatch.setattr(module.Console, "say", lambda _, line: lines.append(line))
    return lines


@pytest.mark.parametrize("mode", [Mode.STARTING, Mode.COASTING])
def test_an_imu_that_is_silent_for_3_s_is_said_once_and_again_after_it_came_back(mode: Mode, said: list[str]) -> None:
    console = Console(quiet=False)
    for k in range(20):
        console.note(_health(0.5 * k, mode))
        assert sum("no IMU sample for 3 s" in line for line in said) == (k >= 6)
    console.note(_health(11.0, Mode.AIDED))
    for k in range(10):
        console.note(_health(12.0 + 0.5 * k, mode))
    assert sum("no IMU sample for 3 s" in line for line in said) == 2


def test_why_it_began_again_is_said_once(said: list[str]) -> None:
    console = Console(quiet=False)
    for k, mode in enumerate((Mode.STARTING, Mode.AIDED, Mode.DEAD_RECKONING)):
        console.note(_health(k, mode, "the attitude was lost; aligning again"))
    assert [line.count("aligning again") for line in said] == [1, 0, 0]


def test_the_first_malformed_message_of_a_topic_is_said_and_the_rest_are_counted(said: list[str], tmp_path: Path) -> None:
    console = Console(quiet=False)
    for k in range(3000):
        console.note(AidStatus(k, k, "/gnss", "unusable", Reason.MALFORMED, detail="20 bytes are no NavSatFix"))
    assert said == ["malformed message on /gnss: 20 bytes are no NavSatFix; see what writes this topic (more are counted)"]
    console.closed([tmp_path / "x.mcap"], 0)
    assert said[1] == "malformed messages on /gnss: 3000"
