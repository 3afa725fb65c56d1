"""The short way of a sample with which nothing happens leads to the same bytes as the long one."""

from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace

from benchmarks.speed.cost import BEGIN_NS, NOISE, PLACE, STEP_NS, Scene, messages
from estimator.filter.history import History
from estimator.filter.quiet import Quiet
from estimator.fusion import Fusion, FusionConfig
from estimator.sources.rest import RestConfig
from logs.wire.codec import encode
from models.messages import Health, ImuSample, Input, Integrity, PoseFix, Tick
from models.state import X

SECOND = 1_000_000_000
FLIGHT_S = 9.0


def _flight(scene: Scene) -> list[Input]:
    return [m for m in messages(scene) if m.arrived_ns < BEGIN_NS + FLIGHT_S * SECOND]


def _changed(flight: list[Input], change: Callable[[ImuSample, int], Input | None]) -> list[Input]:
    """With every sample changed, or left out; k: which one it is."""
    changed = [change(m, (m.t_ns - BEGIN_NS) // STEP_NS) if isinstance(m, ImuSample) else m for m in flight]
    return [m for m in changed if m is not None]


def _gap(m: ImuSample, k: int) -> Input | None:
    """0.3 s without samples, with ticks in their place."""
    return Tick(m.t_ns, m.arrived_ns) if 1200 < k < 1260 else m


def _odd(m: ImuSample, k: int) -> Input | None:
    """Values that are refused, held, beyond our clock, twice the same stamp."""
    match k:
        case 1201:
            return replace(m, gyro_b=(float("nan"), 0.0, 0.0))
        case 1203:
            return replace(m, accel_b=(2000.0, 0.0, 0.0))
        case 1205:
            return replace(m, t_ns=m.t_ns + 9 * SECOND)
        case 1207:
            return replace(m, t_ns=m.t_ns - STEP_NS)
        case _ if 1300 < k < 1500:
            return replace(m, accel_b=(3.0, *m.accel_b[1:]))
    return m


def _outputs(flight: list[Input], config: FusionConfig) -> list[bytes]:
    fusion = Fusion(config)
    return [e.data for m in flight for output in fusion.handle(m) for e in encode(output)]


FIXES, BOTH, GNSS = Scene(), Scene(gnss_hz=5.0), Scene(0.0, 5.0)
LATE = [replace(m, arrived_ns=m.arrived_ns + SECOND) if not isinstance(m, ImuSample) else m for m in _flight(FIXES)]
WITHOUT = [m for m in _flight(FIXES) if isinstance(m, ImuSample) or m.t_ns < BEGIN_NS + 4 * SECOND]
NOISY = [replace(m, covariance=m.covariance / 6.0) if isinstance(m, PoseFix) else m for m in _flight(FIXES)]
FLIGHTS = {
    "fixes": _flight(FIXES),
    "fixes and GNSS, two hypotheses": _flight(BOTH),
    "GNSS alone, eight headings": _flight(GNSS),
    "late fixes": sorted(LATE, key=lambda m: m.arrived_ns),
    "noisier fixes than claimed": NOISY,
    "dead reckoning": WITHOUT,
    "gap": _changed(_flight(BOTH), _gap),
    "odd samples": _changed(_flight(FIXES), _odd),
}


@pytest.mark.parametrize("name", FLIGHTS)
def test_the_short_way_gives_the_bytes_of_the_long_one(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    config = FusionConfig(imu=NOISE, origin=PLACE, rest=RestConfig(enabled=name == "fixes"))
    taken, take = [0], Quiet.take

    def counted(quiet: Quiet, sample: ImuSample) -> object:
        taken[0] += 1
        return take(quiet, sample)

    monkeypatch.setattr(Quiet, "take", counted)
    short = _outputs(FLIGHTS[name], config)
    assert taken[0] > 500  # else nothing is compared
    monkeypatch.setattr(History, "_is_quiet", False)
    assert short == _outputs(FLIGHTS[name], config)


def test_levels_and_health_find_all_hypotheses_at_one_time() -> None:
    """One that does not show is left behind by the short way."""
    fusion, compared, behind = Fusion(FusionConfig(imu=NOISE, origin=PLACE)), 0, 0
    for message in _flight(BOTH):
        out = fusion.handle(message)
        tracker = fusion._history.tracker
        times = {member.filter.t_ns for member in tracker.alignment.members}
        behind += len(times) > 1
        if len(tracker.alignment.members) > 1 and any(isinstance(o, Health | Integrity) for o in out):
            compared += 1
            assert times == {tracker.core.t_ns}
    assert compared > 3
    assert behind > 100


@pytest.mark.parametrize("value", [np.nan, 1e9])
def test_a_state_out_of_bounds_is_not_published(value: float) -> None:
    fusion, flight = Fusion(FusionConfig(imu=NOISE)), iter(_flight(FIXES))
    for message in flight:
        fusion.handle(message)
        quiet = fusion._history.quiet
        if message.t_ns > BEGIN_NS + 5 * SECOND and quiet is not None and quiet.left > 2:
            break
    assert quiet is not None
    hypotheses = quiet.tracker.core.hypotheses
    assert hypotheses is not None
    hypotheses.lead.x[X.V] = value
    (status,) = fusion.handle(next(flight))[:1]
    assert "aligning again" in getattr(status, "detail", "")
