"""The search: it finds the best, says what it cannot know, makes nothing worse, and does not depend on who does the work."""

import json
import math
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import pytest
from distributed import LocalCluster
from typer.testing import CliRunner

from estimator.cli import app
from estimator.config import load, parse
from estimator.tools.fleet import engine
from estimator.tools.tune.keys import KEYS
from estimator.tools.tune.score import Job, Window
from estimator.tools.tune.search import Gain, TuneConfig, TunedKey, Tuner, TuneResult, summary, warning
from tests.estimator.tools.tune.test_score import simulated

BEST = {"imu.gyro_noise": 7e-4, "imu.accel_noise": 4e-2}
_SHORT = ("--coarse", "2", "--fine", "0")
NAMES = ("imu.gyro_noise", "imu.accel_noise", "imu.accel_walk")


class Bowl(Executor):
    """Instead of flights: a score that falls with the square of the decades from BEST, and does not know imu.accel_walk."""

    def __init__(self, noise: float = 0.0) -> None:
        self.runs, self._noise = 0, noise

    def map(self, fn: Callable[..., Any], *iterables: Any, **_: Any) -> Iterator[Any]:  # noqa: ARG002
        return iter([self._windows(job) for job in iterables[0]])

    def _windows(self, job: Job) -> list[Window]:
        self.runs += 1
        config = parse(job.config)
        values = {f"imu.{name}": getattr(config.imu, name) for name in ("gyro_noise", "accel_noise", "accel_walk")} | job.values
        loss = sum(math.log10(values[name] / best) ** 2 for name, best in BEST.items())
        wobble = [math.sin(1e3 * (k + values["imu.accel_walk"])) * self._noise for k in range(8)]
        return [Window(10.0 * k, 20, -(1.0 + 0.1 * k) * loss + wobble[k], 0, 120.0, 120, 2.0, 19) for k in range(8)]


def _tuner(executor: Executor, config: str = "", settings: TuneConfig | None = None) -> Tuner:
    return Tuner(["a", "b"], config, [KEYS[name] for name in NAMES], settings or TuneConfig(), executor)


def test_the_best_is_found_with_few_evaluations_and_the_rest_is_called_poorly_determined() -> None:
    bowl = Bowl(noise=1e-3)
    result = _tuner(bowl).run()
    for name, best in BEST.items():
        assert result.values[name] == pytest.approx(best, rel=0.1)
    gyro, accel, walk = result.keys
    assert gyro.determined
    assert accel.determined
    assert not walk.determined
    assert walk.after == walk.before, "as wide as it was"
    assert gyro.half.mean == pytest.approx(-1.35 * math.log10(2.0) ** 2, rel=0.3)
    assert gyro.half.is_sure
    assert (gyro.before, accel.before) == (2e-3, 0.1)
    assert result.gain.mean > 0.0
    assert result.gain.is_sure
    spread = 0.1 * math.sqrt(5.6) / 1.35  # of windows 1.0, 1.1 ... 1.7, twice, against their mean
    assert result.gain.error == pytest.approx(result.gain.mean * spread / math.sqrt(16.0), rel=0.05)
    assert result.after.score > result.before.score
    assert bowl.runs == 2 * result.evaluations <= 2 * (16 + 40 + 8 + 16)


def test_what_is_best_already_stays_as_it_is() -> None:
    config = "".join(["[imu]\n", *(f"{name[4:]} = {value!r}\n" for name, value in BEST.items())])
    result = _tuner(Bowl(), config, TuneConfig(coarse=4, fine=8)).run()
    assert {name: result.values[name] for name in BEST} == BEST
    assert result.values["imu.accel_walk"] == 3e-3
    assert result.gain.mean == 0.0


def test_what_the_logs_cannot_tell_stays_as_wide_as_it_was() -> None:
    """GIVEN windows that disagree, THEN a wide start is not left for a best that may be chance; a narrow start is."""

    class Torn(Bowl):
        def _windows(self, job: Job) -> list[Window]:
            value = job.values.get("imu.accel_noise", parse(job.config).imu.accel_noise)
            decades = [math.log10(value / BEST["imu.accel_noise"]) + sign * 0.6 for sign in (-1.0, 1.0) * 4]
            return [Window(10.0 * k, 20, -(x**2), 0, 120.0, 120, 2.0, 19) for k, x in enumerate(decades)]

    def tuned(config: str) -> float:
        settings = TuneConfig(coarse=4, fine=15)
        return Tuner(["a", "b"], config, [KEYS["imu.accel_noise"]], settings, Torn()).run().values["imu.accel_noise"]

    assert tuned("") == pytest.approx(0.1)
    assert tuned("[imu]\naccel_noise = 4e-3\n") == pytest.approx(BEST["imu.accel_noise"], rel=0.1)


def test_a_best_beyond_the_bounds_is_said() -> None:
    class Steep(Bowl):
        def _windows(self, job: Job) -> list[Window]:
            value = job.values.get("imu.gyro_noise", 2e-3)
            return [Window(0.0, 20, math.log10(value), 0, 120.0, 120, 2.0, 19)] * 4

    result = _tuner(Steep()).run()
    assert result.keys[0].at_bound
    assert result.values["imu.gyro_noise"] == KEYS["imu.gyro_noise"].high
    assert not result.keys[1].at_bound


def test_logs_that_are_held_out_are_scored_but_not_searched() -> None:
    bowl = Bowl()
    result = _tuner(bowl, settings=TuneConfig(coarse=2, fine=0)).run(["c"])
    assert result.held_out_gain is not None
    assert result.held_out_gain.mean == pytest.approx(result.gain.mean)
    assert result.held_out_logs == ("c",)
    assert bowl.runs == 2 * (result.evaluations - 2) + 2


@pytest.mark.parametrize(
    ("gain", "after", "said"),
    [
        (Gain(0.4, 0.1), 1e-3, ""),
        (Gain(0.05, 0.07), 1e-3, "may be chance"),
        (Gain(-0.02, 0.14), 1e-3, "are worse for it"),
        (Gain(0.0, 0.0), 2e-3, ""),
        (None, 1e-3, ""),
    ],
)
def test_what_held_out_logs_do_not_confirm_is_said(gain: Gain | None, after: float, said: str) -> None:
    """Nothing where nothing was changed, or no log was held out."""
    key = TunedKey("imu.gyro_noise", 2e-3, after, Gain(-1.0, 0.1), Gain(-1.0, 0.1), determined=True, at_bound=False)
    some = summary([Window(0.0, 20, 3.0, 0, 120.0, 120, 2.0, 19)])
    heard = warning(TuneResult({"imu.gyro_noise": after}, (key,), 1, some, some, Gain(0.5, 0.1), held_out_gain=gain))
    assert said in heard
    assert bool(said) == bool(heard)


def test_progress_grows_to_the_end() -> None:
    seen: list[float] = []
    Tuner(["a"], "", [KEYS["imu.gyro_noise"]], TuneConfig(coarse=4, fine=10), Bowl(), seen.append).run()
    assert seen == sorted(seen)
    assert 0.0 < seen[0] < 0.3
    assert seen[-1] <= 1.0


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Path], Path]:
    """Three flights of one vehicle, and a configuration whose accelerometer is far too poor.

    One that is far too good is made up for: what is on the samples beyond the configured noise is measured (models.sampling).
    """
    return _flights(tmp_path_factory.mktemp("tuned"), 65.0)


@pytest.fixture(scope="module")
def short_flights(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Path], Path]:
    """The same, with a few windows each: who does the work must not matter."""
    return _flights(tmp_path_factory.mktemp("short"), 25.0)


def _flights(folder: Path, seconds: float) -> tuple[list[Path], Path]:
    logs = []
    for seed in (1, 2, 3):
        log, simulation = simulated(folder / f"{seed}.mcap", seed, seconds=seconds)
        logs.append(log)
    config = folder / "vehicle.toml"
    true = parse(simulation.config_toml).imu
    text = simulation.config_toml.replace(f"accel_noise = {true.accel_noise!r}", f"accel_noise = {true.accel_noise * 20.0!r}")
    config.write_text(f"# ours\n{text}")
    return logs, config


def _tune(flights: tuple[list[Path], Path], out: Path, *more: str) -> dict[str, Any]:
    (first, second, third), config = flights
    arguments = ["tune", str(first), str(second), "-c", str(config), "-o", str(out), "--hold-out", str(third), "--json"]
    result = CliRunner().invoke(app, [*arguments, "--vary", "imu.accel_noise", "--coarse", "4", "--fine", "8", *more])
    assert result.exit_code == 0, result.output
    return dict(json.loads(result.stdout))


@pytest.mark.long
def test_flights_tell_the_noise_and_others_are_predicted_better_for_it(flights: tuple[list[Path], Path], tmp_path: Path) -> None:
    said = _tune(flights, tmp_path / "tuned.toml", "--jobs", "1")
    tuned, before = load(tmp_path / "tuned.toml"), load(flights[1])
    assert 8.0 < before.imu.accel_noise / tuned.imu.accel_noise < 40.0
    assert tuned.imu.gyro_noise == before.imu.gyro_noise
    assert (tmp_path / "tuned.toml").read_text().startswith("# ours\n")
    assert said["held_out_gain"]["mean"] > 0.3
    assert said["held_out_before"]["nis_per_dof"] < 0.6 < said["held_out_after"]["nis_per_dof"] < 1.3
    (key,) = said["keys"]
    assert key["double"]["mean"] < -0.3 < -0.2 < key["half"]["mean"] < 0.2  # half of it is made up for


@pytest.fixture(scope="module")
def alone(short_flights: tuple[list[Path], Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A short search by one process."""
    alone = _tune(short_flights, tmp_path_factory.mktemp("alone") / "tuned.toml", "--jobs", "1", *_SHORT)
    assert alone["keys"][0]["half"]["mean"] != 0.0  # there is something to agree on
    return alone


@pytest.mark.long
def test_the_same_by_two_processes(short_flights: tuple[list[Path], Path], alone: dict[str, Any], tmp_path: Path) -> None:
    assert _tune(short_flights, tmp_path / "two.toml", "--jobs", "2", *_SHORT) == alone


@pytest.mark.long
def test_the_same_over_a_scheduler(short_flights: tuple[list[Path], Path], alone: dict[str, Any], tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of dask's own
        with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0") as cluster:
            there = _tune(short_flights, tmp_path / "there.toml", "--scheduler", cluster.scheduler_address, *_SHORT)
    assert there == alone


def test_what_cannot_be_tuned_is_said_in_one_line(
    short_flights: tuple[list[Path], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "_ANSWERS", "0.5s")
    (first, *_), config = short_flights
    out = str(tmp_path / "tuned.toml")
    cases = {
        ("--vary", "imu.axes"): "--vary imu.axes: cannot be tuned",
        ("--hold-out", str(first)): "is tuned on, so it cannot be held out",
        ("--scheduler", "tcp://127.0.0.1:1"): "tcp://127.0.0.1:1: ",
        ("-o", str(first)): "would overwrite the input",
        ("-o", str(tmp_path / "no" / "tuned.toml")): "is no folder",
    }
    for more, line in cases.items():
        result = CliRunner().invoke(app, ["tune", str(first), "-c", str(config), "-o", out, *more])
        assert result.exit_code == 1, more
        assert result.stderr.startswith("landfix: ")
        assert line in result.stderr
        assert result.stderr.count("\n") == 1
    missing = CliRunner().invoke(app, ["tune", str(tmp_path / "no.mcap"), "-o", out])
    assert (missing.exit_code, missing.stderr) == (1, f"landfix: {tmp_path / 'no.mcap'}: no such file or directory\n")
    assert not Path(out).exists()
