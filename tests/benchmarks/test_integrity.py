"""Counting and bounds of the integrity campaign; one short flight of each group that needs no recorded data."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from distributed import LocalCluster

from benchmarks.integrity.__main__ import jobs
from benchmarks.integrity.pictures import draw
from benchmarks.integrity.record import added
from benchmarks.integrity.report import _delay, bound, group_of, groups, groups_table, is_faulty, summary, table
from benchmarks.integrity.rows import Row, _delays, _events, _false_alerts
from benchmarks.integrity.runs import run
from benchmarks.jobs import run_jobs
from models.messages import Alert, Integrity

S = 1_000_000_000


def test_the_bound_is_that_of_clopper_and_pearson() -> None:
    assert bound(0, 3412) == pytest.approx(1.0 - 0.05 ** (1.0 / 3412), rel=1e-6)  # rule of three
    assert bound(1, 100) == pytest.approx(0.0466, abs=1e-4)
    assert bound(3, 3) == 1.0


def test_errors_that_follow_one_another_are_one_event() -> None:
    assert _events(np.array([0, 1, 2, 9, 30, 31]) * S) == 2
    assert _events(np.empty(0, np.int64)) == 0


def _level(t_s: float, state: Alert) -> Integrity:
    return Integrity(round(t_s * S), 0, state, "", 1e-5, 1.0, 1.0, 10.0, 10.0, (), (), (), 1.0, 1.0)


def test_the_time_to_alert_counts_from_the_error_passing_the_limit() -> None:
    t_ns = (np.arange(0.0, 60.0, 0.1) * S).astype(np.int64)
    t_s = t_ns / S
    far = ((t_s > 5.0) & (t_s < 8.0)) | ((t_s > 20.0) & (t_s < 22.0)) | ((t_s > 40.0) & (t_s < 41.0))
    usable, stop = Alert.USABLE, Alert.DO_NOT_USE
    states = [(0.0, usable), (5.6, stop), (9.0, usable), (19.0, stop), (30.0, usable), (45.0, stop)]
    levels = [_level(t, state) for t, state in states]
    first, second, never = _delays(levels, t_ns, far, {stop})
    assert first == pytest.approx(0.5, abs=0.11)
    assert second == 0.0
    assert never is None


def test_an_alert_without_an_error_beyond_the_limit_is_a_false_one() -> None:
    usable = np.array([False, True, False, False, True, False, True, False])
    too_far = np.array([False, False, False, True, False, False, False, False])
    assert _false_alerts(usable, too_far) == 2  # the first spell is the start, the second has an error


def test_a_shifted_map_beside_gnss_is_covered_and_alerted_at_once(tmp_path: Path) -> None:
    row = run(("stress", "sim/rotor", "map shift", 20.0, 0, str(tmp_path)))
    assert row.horizontal is not None
    assert (row.misled, row.hazards, row.events[2]) == (0, 0, 0)  # at 1e-5 for a second of the alignment, which is not usable
    assert row.horizontal.unavailable == row.horizontal.compared
    assert row.alerts_s == row.stops_s == (0.0,)
    assert is_faulty(row)
    assert msgspec.json.decode(msgspec.json.encode(row), type=Row) == row


@pytest.mark.long
def test_a_village_is_in_the_tables(tmp_path: Path) -> None:
    row = run(("stress", "sim/rotor", "map shift", 20.0, 0, str(tmp_path)))
    village = run(("village", "rotor", "fixes", 60.0, 0, str(tmp_path)))
    assert village.within_10_m > 200
    rows = [village, row]
    said = summary(rows)
    assert "no fault injected: 0.0" in said
    assert len(table(rows).rows) == 2
    assert [line[0] for line in groups_table(rows).rows] == ["villages", "beyond the fault table"]
    draw(groups(rows), tmp_path / "stanford.png")
    assert (tmp_path / "stanford.png").stat().st_size > 10_000


def test_a_delay_that_never_ended_is_the_longest() -> None:
    assert _delay([]) == "-"
    assert _delay([0.2, 0.0, 0.1]) == "0.1 / 0.2"
    assert _delay([None, 0.0, 3.0]) == "3.0 / never, 1 of 3 never"


def test_the_record_counts_a_job_once_and_keeps_the_others(tmp_path: Path) -> None:
    record = tmp_path / "runs.csv"
    flown = Row("stress", "sim/rotor", "map shift", 5.0, 0, hours=0.02, events=(2, 1, 0), hazards=3, worst=1.25)
    village = Row("village", "rotor", "fixes", 300.0, 0, hours=0.08, events=(1, 0, 0))
    added([flown, village], record)
    again = msgspec.structs.replace(village, events=(0, 0, 0))
    more = msgspec.structs.replace(again, seed=1)
    rows = added([again, more], record)
    assert rows == [flown, again, more]
    assert added([], record) == rows
    assert "0.16 h, 2 flights; events of error > PL at 0.001: 0" in summary(rows)
    assert "events of error > PL at 0.001: 2" in summary(rows)


def test_jobs_are_named_once() -> None:
    work = jobs(Path("tasks"), quick=True, seeds=1)
    assert len(set(work)) == len(work)
    assert {job[0] for job in work} == {"village", "stress"}


@pytest.mark.long
def test_the_workers_of_a_scheduler_do_what_is_left(tmp_path: Path) -> None:
    work = [("village", vehicle, "fixes", 20.0, 0, "") for vehicle in ("rotor", "wing")]
    kept = tmp_path / "rows.jsonl"
    here = run_jobs(work[:1], run, Row, kept)
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0") as local:
        rows = run_jobs(work, run, Row, kept, resume=True, scheduler=local.scheduler_address)
    assert rows == [*here, run(work[1])]
    assert len(kept.read_text().splitlines()) == len(work)


@pytest.mark.parametrize(
    ("group", "flight", "kind", "size", "name"),
    [
        ("stress", "sim/wing", "GNSS pulled, fixes 1 Hz", 3.0, "conflicts"),
        ("stress", "sim/wing", "map shift", 5.0, "beyond the fault table"),
        ("stress", "sim/wing", "fix delay", 80.0, "stress table"),
        ("stress", "euroc/MH_03_medium", "nothing, with GNSS", 0.0, "recorded flights"),
        ("real", "euroc/MH_03_medium", "B", 0.0, "outages"),
        ("real", "euroc/MH_03_medium", "X", 0.0, "false fixes"),
        ("drawn", "rotor", "", 120.0, ""),
    ],
)
def test_a_flight_is_counted_in_one_group(group: str, flight: str, kind: str, size: float, name: str) -> None:
    assert group_of(Row(group, flight, kind, size, 0)) == name


@pytest.mark.usefixtures("landfix_data")
def test_false_fixes_after_an_outage_stay_below_the_level(tmp_path: Path) -> None:
    """Three, then eight of one place: a hypothesis whose position is unknown does not take theirs for confirmed."""
    row = run(("real", "quad/flight_a", "C", 0.0, 0, str(tmp_path)))
    assert row.events == (0, 0, 0)
