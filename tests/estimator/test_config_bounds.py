"""No number, text or size of a configuration file ends the program: it is refused in one line, or it flies."""

import math
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import msgspec
import msgspec.inspect as mi
import numpy as np
import pytest

from benchmarks.service.vehicle import gnss, imu, pose_fix
from estimator.config import Config, ConfigError, parse, read
from estimator.fusion import Fusion
from estimator.publish import Publisher
from estimator.service.autopilot.output_policy import OutputPolicy
from estimator.service.base.clock import Clock, Stamps
from estimator.service.mavlink.inputs import Inputs
from estimator.service.zenoh.config import session_config
from models.messages import AidStatus, Estimate, Input, LandmarkFix, Reading, Reason, Tick
from models.sim.scenario_file import ScenarioError, loads
from tests import long

SECOND = 1_000_000_000
T0 = 1_795_000_000 * SECOND
AWKWARD = (
    "1e308",
    "-1e308",
    "5e-324",
    "-5e-324",
    "0",
    "0.0",
    "-0.0",
    "-1",
    "nan",
    "inf",
    "-inf",
    "1" + "0" * 400,
    "9" * 5000,
    str(2**63),
)


def _numbers(info: mi.Type, path: str = "") -> Iterator[tuple[str, int, int, mi.FloatType | mi.IntType]]:
    """Every number of the configuration: its key, its place among how many (a list), and its type with the bounds."""
    assert isinstance(info, mi.StructType)
    for field in info.fields:
        key = f"{path}{field.encode_name}"
        for kind in _plain(field.type):
            if isinstance(kind, mi.StructType):
                yield from _numbers(kind, f"{key}.")
            elif isinstance(kind, mi.TupleType | mi.VarTupleType):
                items = kind.item_types if isinstance(kind, mi.TupleType) else (kind.item_type,)
                inner = [next(_plain(item)) for item in items]
                yield from ((key, k, len(inner), t) for k, t in enumerate(inner) if isinstance(t, mi.FloatType | mi.IntType))
            elif isinstance(kind, mi.FloatType | mi.IntType):
                yield key, 0, 0, kind


def _plain(info: mi.Type) -> Iterator[mi.Type]:
    if isinstance(info, mi.Metadata):
        yield from _plain(info.type)
    elif isinstance(info, mi.UnionType):
        for one in info.types:
            yield from _plain(one)
    else:
        yield info


ALL = list(_numbers(mi.type_info(Config)))


def _extremes(kind: mi.FloatType | mi.IntType) -> tuple[float, float]:
    low = kind.ge if kind.ge is not None else math.nextafter(max(kind.gt or 0.0, 1e-12), 1.0)
    high = kind.le if kind.le is not None else math.nextafter(kind.lt or 0.0, -math.inf)
    return low, high


def _toml(key: str, place: int, count: int, value: object) -> str:
    section, _, name = key.rpartition(".")
    fill = {"gnss.antenna_b_m": "0.0", "map.origin": "45.0", "mavlink.attitude_sigma_deg": "5.0"}.get(key, "1.0")
    text = f"[{', '.join(str(value) if k == place else fill for k in range(count))}]" if count else str(value)
    attitude = '\n[inputs]\nattitude = "/attitude"' if "attitude" in key else ""
    return f"[{section}]\n{name} = {text}{attitude}\n"


@pytest.mark.parametrize("number", ALL, ids=lambda n: f"{n[0]}[{n[1]}]")
def test_every_number_has_bounds_on_both_sides(number: tuple[str, int, int, mi.FloatType | mi.IntType]) -> None:
    key, place, count, kind = number
    assert kind.le is not None or kind.lt is not None
    assert kind.ge is not None or kind.gt is not None
    assert kind.gt != 0, "a number as close to 0 as it likes has an inverse that overflows"
    low, high = _extremes(kind)
    for outside in (low - max(1.0, abs(low)), high + max(1.0, abs(high))):
        with pytest.raises(ConfigError) as refused:
            parse(_toml(key, place, count, int(outside) if isinstance(kind, mi.IntType) else outside), "v.toml")
        assert str(refused.value).startswith(f"v.toml: {key}")
        assert "\n" not in str(refused.value)
        assert any(sign in str(refused.value) for sign in ("<", ">"))


_NOT_FLOWN = {
    *("autopilot", "clock", "log", "mavlink", "px4", "service", "vision", "visual_odometry", "zenoh"),  # not the estimator's
    *("airspeed", "beacon", "drag", "heading", "magnetometer", "odometry", "range", "rest", "velocity_body", "wind"),  # off
}


@cache
def _flight() -> tuple[Input, ...]:
    """Three seconds of everything, with a gap of half a second in the IMU and fixes that are false."""
    rng, messages = np.random.default_rng(8), list[Input]()
    for k in range(150):
        t_ns = T0 + k * SECOND // 50
        if not 100 <= k < 125:
            messages.append(imu(t_ns, rng))
        if k % 10 == 3:
            messages += gnss(t_ns, rng)
            messages.append(Reading(t_ns, t_ns, "/baro", "baro", (95_000.0 + rng.normal(),)))
        if k % 25 == 7:
            fix = pose_fix(t_ns, rng)
            messages.append(fix)
            seen = LandmarkFix(t_ns, t_ns, fix.p_n, fix.q_nb_wxyz, fix.covariance, None, ("a",), 0.9, 0.5)
            messages.append(seen)
        if k % 40 == 20:
            wrong = pose_fix(t_ns, rng)
            messages.append(msgspec.structs.replace(wrong, p_n=(1e3, -1e3, 50.0), topic="/other"))
        if k % 25 == 0:
            messages.append(Tick(t_ns, t_ns))
    return tuple(messages)


def _fly(config: Config) -> int:
    """How many estimates come of it. All numbers are finite, nothing fails inside."""
    fusion, publisher, estimates = Fusion(config.fusion()), Publisher(config.output), 0
    for message in _flight():
        outputs = fusion.handle(message)
        assert all(encoded.data for encoded in publisher.encoded(outputs))
        for output in outputs:
            assert getattr(output, "reason", None) is not Reason.INTERNAL, output
            if isinstance(output, Estimate):
                estimates += 1
                assert np.isfinite(output.nav).all()
                assert np.isfinite(output.covariance).all()
                assert (np.diagonal(output.covariance) >= 0.0).all()
            elif isinstance(output, AidStatus):
                assert not math.isinf(output.test_ratio)
    return estimates


def test_the_flight_of_this_test_is_one() -> None:
    assert _fly(parse('[inputs]\nbaro = "/baro"')) > 50


@long.parametrize("number", ALL, one_in=9, ids=lambda n: f"{n[0]}[{n[1]}]")
def test_every_number_flies_at_its_extremes(number: tuple[str, int, int, mi.FloatType | mi.IntType], tmp_path: Path) -> None:
    key, place, count, kind = number
    for value in _extremes(kind):
        shown = repr(int(value)) if isinstance(kind, mi.IntType) else repr(float(value))
        config = parse(_toml(key, place, count, shown))
        if key.partition(".")[0] not in _NOT_FLOWN:
            _fly(config)
        Stamps(Clock(), config.clock)
        OutputPolicy(config.autopilot)
        assert len(list(Inputs(config.mavlink, config.inputs, config.geoid_m).requests(T0, None))) > 0
        session_config(config.zenoh, tmp_path, [], [])


def _refusal(text: str) -> str:
    try:
        parse(text, "v.toml")
    except ConfigError as error:
        return str(error)
    return ""


@long.parametrize("key", sorted({key for key, *_ in ALL}), one_in=4)
def test_awkward_numbers_are_taken_within_the_bounds_or_refused_by_name(key: str) -> None:
    for _, place, count, kind in (n for n in ALL if n[0] == key):
        low, high = _extremes(kind)
        for text in AWKWARD:
            if refusal := _refusal(_toml(key, place, count, text)):
                assert refusal.isprintable()
                assert len(refusal) < 500
                assert refusal.startswith(f"v.toml: {key}") or len(text) > 4300
            else:
                assert low <= float(text) <= high


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 100_000 + "]" * 100_000,
        "a = " + "{b=" * 100_000,
        "[" + "a." * 50_000 + "a]",
        "[imu]\ngyro_noise = " + "[" * 200 + "]" * 200,
        "[imu]\ngyro_noise = " + "[[1,2],[3,[4]]]",
        "[imu]\n" + '"' + "x" * 400_000 + '" = 1',
        '[imu]\n"a\\nb" = 1',
        '["a\\u0000b"]',
        '[rig]\nfile = "' + "x" * 400_000 + '\\u0000"',
        '[rig]\nfile = "a\\u0000b"',
        '[inputs]\nimu = ["/imu", "/i\\u0000mu"]',
        '[log]\nfolder = "a\\nb"',
        "[mavlink]\nlisten_to = [1, 1e300]",
        "[mavlink]\nlisten_to = [1, nan]",
        "[gnss]\nantenna_b_m = [nan, 0, 0, 0]",
        "[gnss]\nprobation = 1979-05-27",
        "x" * 2_000_000,
    ],
    ids=lambda text: text[:20],
)
def test_a_text_that_no_person_writes_is_one_line(text: str, tmp_path: Path) -> None:
    file = tmp_path / "v.toml"
    file.write_text(text)
    with pytest.raises(ConfigError) as refused:
        read(file)
    assert str(refused.value).startswith(f"{file}: ")
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < 1000


def test_a_file_that_never_ends_and_one_that_is_no_text_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"^/dev/zero: is larger than 1_000_000 bytes$"):
        read(Path("/dev/zero"))
    (tmp_path / "v.toml").write_bytes(b"[imu]\nsays = '\xff\xfe'")
    with pytest.raises(ConfigError, match=r"v\.toml: is not a text file$"):
        read(tmp_path / "v.toml")


@pytest.mark.parametrize("data", [b"a = " + b"[" * 100_000, b"duration_s = " + b"9" * 5000, b"\xff", b"#" * 2_000_000])
def test_the_same_of_a_scenario(data: bytes) -> None:
    with pytest.raises(ScenarioError) as refused:
        loads(data, "s.toml")
    assert str(refused.value).startswith("s.toml: ")
    assert "\n" not in str(refused.value)
