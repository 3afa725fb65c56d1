"""A run over a store: rows equal those of the commands, whatever fails on the way, and none is computed twice."""

import os
import signal
import threading
import time
from pathlib import Path

import msgspec
import pytest
from distributed import Client, LocalCluster

from estimator.config import load
from estimator.replay.replay import replay
from estimator.tools.fleet import engine
from estimator.tools.fleet.engine import cluster
from estimator.tools.fleet.errors import FleetError
from estimator.tools.fleet.results import SCHEMA, read
from estimator.tools.fleet.rows import COSTS, of_evaluation
from estimator.tools.fleet.run import run, settings_of
from estimator.tools.fleet.store import flights
from logs.evaluation.evaluate import evaluate
from tests.estimator.tools.fleet.bucket import bucket
from tests.estimator.tools.fleet.conftest import FLIGHTS


def rows(folder: str | Path, label: str) -> list[dict[str, object]]:
    """The rows without what differs between equal runs."""
    found: list[dict[str, object]] = read(str(folder), [label]).to_pylist()
    for row in found:
        for name in (*COSTS, "label", "key", "stored_bytes", "log"):
            del row[name]
    return found


@pytest.fixture(scope="module")
def before(fleet: Path, client: Client, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a run over local files."""
    results = tmp_path_factory.mktemp("results")
    summary = run(flights([f"{fleet}/*.mcap"]), settings_of("before", fleet / "vehicle.toml", "/truth"), str(results), client)
    assert (summary.flights, summary.done, summary.failed, summary.unfinished) == (FLIGHTS, FLIGHTS, 0, {})
    return results


def test_a_row_is_what_replay_and_evaluate_say(fleet: Path, before: Path, tmp_path: Path) -> None:
    summary = replay(fleet / "0.mcap", tmp_path / "0.mcap", load(fleet / "vehicle.toml"))
    expected = of_evaluation(evaluate(tmp_path / "0.mcap"))
    row = read(str(before)).to_pylist()[0]
    assert row["log"] == str(fleet / "0.mcap")
    assert row["first_estimate_s"] == summary.first_estimate_s
    assert {name: dict(row[name]) if isinstance(value, dict) else row[name] for name, value in expected.items()} == expected
    assert expected["rmse_m"] > 0.0
    assert row["read_bytes"] <= row["stored_bytes"]


def test_what_has_a_row_is_not_computed_again(fleet: Path, before: Path, client: Client) -> None:
    names = sorted(p.name for p in before.rglob("*.parquet"))
    settings = settings_of("before", fleet / "vehicle.toml", "/truth")
    summary = run(flights([f"{fleet}/*.mcap"]), settings, str(before), client)
    assert (summary.known, summary.done) == (FLIGHTS, 0)
    assert sorted(p.name for p in before.rglob("*.parquet")) == names
    other = msgspec.structs.replace(settings, truth="/pose_fix")
    with pytest.raises(FleetError, match=r"0.mcap: has a row of other inputs, .* under before; take another --label"):
        run(flights([f"{fleet}/0.mcap"]), other, str(before), client)


@pytest.mark.long
def test_a_store_that_fails_and_a_worker_that_is_killed_change_no_row(fleet: Path, before: Path) -> None:
    expected = rows(before, "before")
    with bucket(0.05) as (store, application), cluster(2) as client:
        store.put([str(p) for p in fleet.glob("*.mcap")], "flights/")
        victim = next(iter(client.run(os.getpid).values()))
        timer = threading.Timer(1.0, os.kill, (victim, signal.SIGKILL))
        timer.start()
        settings = settings_of("stormy", fleet / "vehicle.toml", "/truth")
        summary = run(flights(["s3://flights/*.mcap"]), settings, "s3://flights/results", client)
        timer.join()
        deadline = time.monotonic() + 30.0
        while victim in client.run(os.getpid).values() and time.monotonic() < deadline:
            time.sleep(0.2)
        assert victim not in client.run(os.getpid).values()
        assert (summary.done, summary.unfinished) == (FLIGHTS, {})
        assert rows("s3://flights/results", "stormy") == expected
        assert application.gets >= 3 * FLIGHTS
        store.put([str(p) for p in fleet.glob("*.mcap")], "flights/")  # the same bytes, later
        assert run(flights(["s3://flights/*.mcap"]), settings, "s3://flights/results", client).known == FLIGHTS


def test_a_log_that_fails_has_a_row_that_says_why(fleet: Path, client: Client, tmp_path: Path) -> None:
    (tmp_path / "broken.mcap").write_bytes(b"no log at all")
    (tmp_path / "torn.mcap").write_bytes((fleet / "0.mcap").read_bytes()[:150_000])
    settings = settings_of("run", fleet / "vehicle.toml", "/truth")
    summary = run(flights([f"{tmp_path}/*.mcap"]), settings, str(tmp_path / "results"), client)
    broken, torn = read(str(tmp_path / "results")).to_pylist()
    assert (summary.done, summary.failed) == (2, 1)
    assert broken["error"] == f"{tmp_path}/broken.mcap: is not an MCAP file, or its first bytes are damaged"
    assert broken["rmse_m"] is None
    assert (torn["error"], torn["torn"]) == ("", True)


def test_a_worker_with_another_program_is_refused(fleet: Path, client: Client, tmp_path: Path) -> None:
    settings = msgspec.structs.replace(settings_of("run", None, "/truth"), code="another")
    with pytest.raises(FleetError, match="a worker runs another landfix"):
        run(flights([f"{fleet}/0.mcap"]), settings, str(tmp_path), client)


def test_a_run_that_no_worker_is_left_for_ends_with_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "_ASK_S", 0.1)
    monkeypatch.setattr(engine, "_WITHOUT_WORKER_S", 0.5)
    with (
        LocalCluster(n_workers=0, dashboard_address=None) as local,
        Client(local) as client,
        pytest.raises(FleetError, match="no worker is left"),
    ):
        list(engine.results(client, str, [1, 2]))


def test_the_table_has_the_columns_of_a_row(before: Path) -> None:
    assert set(read(str(before)).column_names) == {*SCHEMA.names, "label"}
