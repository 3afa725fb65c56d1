"""The page's sensor, run as it is written there: through the codec, the registry and the estimator."""

import re
from pathlib import Path
from textwrap import indent
from typing import Annotated, Any, TypeAlias

import msgspec
import numpy as np
import pytest
from msgspec import Meta

from estimator.fusion import FusionConfig
from estimator.strict_toml import decode
from logs.wire.codec import Decoder, Topics, encode_input
from logs.wire.sensors import SENSORS, Sensor
from models.messages import Input, Reading, Reason
from models.sim.scenario import EPOCH_NS, Simulation
from models.state import E
from tests.estimator.scenes import Run, by_arrival, config_of, error, fly, simulated, within

PAGE = Path(__file__).parents[2] / "docs" / "own_sensor.md"
FLIGHT = """
duration_s = 60.0
[vehicle]
kind = "multirotor"
[gnss]
sigma_m = [2.0, 2.0, 4.0]
[pose_fix]
rate_hz = 1.0
outages_s = [[10.0, 60.0]]
"""
WATER_M = -1.5

_Page: TypeAlias = tuple[dict[str, Any], str]  # what its code defines, and its TOML


def _read() -> _Page:
    found = re.findall(r"^```(python|toml)\n(.*?)^```$", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    source, registry, topics, entry = (text for kind, text in found if kind == "python")
    (toml,) = (text for kind, text in found if kind == "toml")
    names: dict[str, Any] = {
        "FusionConfig": FusionConfig,
        "Topics": Topics,
        "Sensor": Sensor,
        "Annotated": Annotated,
        "Meta": Meta,
    }
    exec(source, names)
    exec(f"class Sources(FusionConfig, frozen=True, kw_only=True):\n{indent(registry, '    ')}", names)
    exec(f"class Inputs(Topics, frozen=True):\n{indent(topics, '    ')}", names)
    names["entry"] = eval(entry, names)
    return names, toml


@pytest.fixture(scope="module")
def flight() -> tuple[Simulation, FusionConfig]:
    """Before the codec knows of the sensor: what the program itself reads is as ever."""
    simulation = simulated(FLIGHT)
    return simulation, config_of(simulation)


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch) -> _Page:
    names, toml = _read()
    for kind, sensor in names["entry"].items():
        monkeypatch.setitem(SENSORS, kind, sensor)
    return names, toml


def _configured(names: dict[str, Any], toml: str, known: FusionConfig) -> tuple[FusionConfig, Decoder]:
    whole = msgspec.defstruct("Whole", [("inputs", names["Inputs"]), ("laser", names["LaserConfig"])], forbid_unknown_fields=True)
    given: Any = decode(whole, toml, "page")
    config = names["Sources"](**{name: getattr(known, name) for name in known.__struct_fields__}, laser=given.laser)
    return config, Decoder(given.inputs)


def _readings(flight: Simulation) -> list[Input]:
    rng, truth = np.random.default_rng(2), flight.truth
    readings: list[Input] = []
    for k in range(0, len(truth.t_ns), 20):
        range_m = -float(truth.p_n[k, 2]) - WATER_M + 0.2 * rng.standard_normal()
        readings.append(Reading(int(truth.t_ns[k]), int(truth.t_ns[k]), "/laser", "laser", (range_m,)))
    return readings


def _flown(page: _Page, flight: tuple[Simulation, FusionConfig], readings: list[Input]) -> Run:
    simulation, known = flight
    config, decoder = _configured(*page, known)
    sent = [(encode_input(m), m.arrived_ns) for m in readings]
    came = [decoder.decode(message.topic, message.schema, message.data, at) for message, at in sent]
    return fly(simulation, config, by_arrival([*simulation.messages, *(m for m in came if m is not None)]))


def test_the_sensor_of_the_page_is_read_judged_and_fused(page: _Page, flight: tuple[Simulation, FusionConfig]) -> None:
    run = _flown(page, flight, _readings(flight[0]))
    assert run.internal_errors() == []
    assert run.reasons("/laser")[Reason.FUSED] > 0.95 * sum(run.reasons("/laser").values()) - 60
    down = E.P.stop - 1
    late = within(run.estimates, 30.0, 60.0)
    off = np.array([error(e, flight[0].truth)[down] for e in late])
    assert np.abs(off).max() < 0.5
    assert np.sqrt(late[-1].covariance[down, down]) < 0.2


def test_a_reading_beyond_its_range_is_refused_with_the_reason_of_the_page(
    page: _Page, flight: tuple[Simulation, FusionConfig]
) -> None:
    run = _flown(page, flight, [Reading(EPOCH_NS + 5 * 10**9, EPOCH_NS + 5 * 10**9, "/laser", "laser", (500.0,))])
    (status,) = run.last_words("/laser").values()
    assert status.reason is Reason.IMPLAUSIBLE
    assert "longest_m" in status.detail
