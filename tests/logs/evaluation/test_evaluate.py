import io
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from rich.console import Console

from logs.evaluation.collected import HealthPoint, NoEstimateError, read
from logs.evaluation.evaluate import assess, compare, evaluate, find_outages
from logs.evaluation.metrics import nees
from logs.evaluation.records import ConsistencySummary, Evaluation
from logs.evaluation.table import odometry, print_table
from logs.evaluation.trajectory import decode
from logs.store.reader import LogError, LogReader
from logs.wire import schemas
from logs.wire.codec import encode, encode_input, encode_truth
from models.messages import AidStatus, GnssFix, Reason
from tests import long
from tests.logs import flight_log
from tests.logs.flight_log import EPOCH_NS, Flight, geodetic, rewritten, truth_at

S = 1_000_000_000


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("evaluate") / "consistent.mcap"
    flight_log.write(path, Flight())
    return path


@pytest.fixture(scope="module")
def consistent(log: Path) -> Evaluation:
    return evaluate(log)


def test_extent(consistent: Evaluation) -> None:
    assert consistent.duration_s == pytest.approx(120.0)
    assert (
        consistent.estimates,
        consistent.truth_samples,
        consistent.compared,
        consistent.without_estimate,
        consistent.without_truth,
    ) == (
        3001,
        3001,
        3001,
        0,
        0,
    )
    assert consistent.distance_m == pytest.approx(605.0, abs=2.0)  # 120 s at 5 m/s and a little up and down
    assert consistent.notes == ()


def test_accuracy_is_what_the_filter_of_the_log_has(consistent: Evaluation) -> None:
    a = consistent.accuracy
    assert a is not None
    assert 0.3 < a.aided_position_m.rmse < 0.5  # sigma of 0.14 to 0.25 m an axis
    assert a.position_m.rmse > 1.3 * a.aided_position_m.rmse
    assert a.position_m.rmse**2 == pytest.approx(a.horizontal_m.rmse**2 + a.vertical_m.rmse**2)
    assert a.attitude_deg.rmse**2 == pytest.approx(a.tilt_deg.rmse**2 + a.heading_deg.rmse**2)
    assert a.sim3_aligned_m.rmse <= a.se3_aligned_m.rmse <= a.yaw_aligned_m.rmse
    assert a.sim3_scale == pytest.approx(1.0, abs=0.02)
    assert [r.over for r in a.relative] == ["1 s", "10 s", "10 m", "100 m"]


def steadily_aided(path: Path, error_scale: float) -> ConsistencySummary:
    flight_log.write(path, Flight(outages=(), error_scale=error_scale))
    consistency = evaluate(path).consistency
    assert consistency is not None
    return consistency


def test_a_consistent_estimate_is_called_so(tmp_path: Path) -> None:
    h = steadily_aided(tmp_path / "consistent.mcap", 1.0)
    assert [h.position.dof, h.attitude.dof, h.velocity.dof, h.pose.dof] == [3, 3, 3, 6]
    for c in (h.position, h.position_aided, h.attitude, h.velocity, h.pose):
        assert c.consistent
        assert 0.8 < c.mean < 1.25
        assert 0.9 < c.covered < 0.99
        assert 0.9 < c.inside < 0.99
    assert h.position_outages.n == 0
    assert 0.9 < h.radius95_covered < 0.99


def test_errors_half_as_large_again_are_not(tmp_path: Path) -> None:
    h = steadily_aided(tmp_path / "sure.mcap", 1.5)
    for c in (h.position, h.position_aided, h.attitude, h.velocity, h.pose):
        assert not c.consistent
        assert c.mean > 1.8
        assert c.covered < 0.88
    assert h.radius95_covered < 0.88


def test_outages_and_their_drift(log: Path, consistent: Evaluation) -> None:
    assert [o.source for o in consistent.outages] == ["all", "all"]  # one source only: not listed twice
    first, second = consistent.outages
    assert [first.start_s, first.duration_s] == pytest.approx([20.0, 10.0])
    assert second.start_s + second.duration_s == pytest.approx(90.0)
    assert consistent.without_absolute_s == pytest.approx(first.duration_s + second.duration_s)
    assert second.drift is not None
    assert second.drift.distance_m == pytest.approx(161.0, abs=1.0)
    assert second.drift.end_percent == pytest.approx(100 * second.drift.end_m / second.drift.distance_m)
    assert second.radius95_end_m == pytest.approx(2.4477 * np.sqrt(0.3**2 * 32), rel=0.03)  # 32 s of random walk
    collected = read(log)
    c = compare(collected.estimate, collected.truth)
    c = c[(c.t_ns > EPOCH_NS + 58 * S) & (c.t_ns < EPOCH_NS + 90 * S)]
    assert second.nees_position == pytest.approx(nees(c.p_error, c.p_covariance).mean() / 3)
    assert second.attitude_end_deg == pytest.approx(np.rad2deg(np.linalg.norm(c.theta_error[-1])))


def test_an_outage_with_odometry_stands_beside_the_flight_without_it(log: Path, consistent: Evaluation) -> None:
    """Increments are counted in the outage alone; the other estimate is 3 m off all the time."""
    collected = read(log)
    _, outage = consistent.outages
    start_s = (int(collected.estimate.t_ns[0]) - EPOCH_NS) * 1e-9 + outage.start_s
    steps = [aid(start_s + s, "/odometry", "odometry") for s in (-1.0, 0.5, 1.0, outage.duration_s + 1.0)]
    gated = aid(start_s + 1.5, "/odometry", "odometry", Reason.GATED)
    beside = replace(collected.estimate, p=collected.estimate.p + np.array([3.0, 0.0, 0.0]))
    assessed = assess(replace(collected, aids=(*collected.aids, *steps, gated)), "flight", without_odometry=beside)
    first, found = assessed.outages
    assert (first.increments, found.increments) == (0, 2)
    assert outage.drift is not None
    assert found.without_odometry_m is not None
    assert abs(found.without_odometry_m - 3.0) <= outage.drift.end_m + 1e-6
    title, header, rows = odometry(assessed)
    assert (title.split(":")[0], header[-1]) == ("Odometry in outages", "without m")
    assert rows[0][3] == "2"
    assert not odometry(consistent)[2]


def test_modes_aids_latency_and_resets(consistent: Evaluation) -> None:
    assert consistent.modes == {"aided": pytest.approx(0.69, abs=0.01), "dead_reckoning": pytest.approx(0.31, abs=0.01)}
    (aid,) = consistent.aids
    assert (aid.topic, aid.kind, list(aid.reasons)) == ("/pose_fix", "pose", ["fused", "gated"])
    assert aid.reasons["gated"] == pytest.approx(sum(aid.reasons.values()) / 10, abs=2)
    assert aid.nis == pytest.approx(1.0, abs=0.15)
    assert aid.test_ratio is not None
    assert aid.test_ratio.max == 0.4
    assert aid.delay_s is not None
    assert aid.delay_s.p50 == 0.25
    assert consistent.latency_s["/landfix/odometry"].p95 == pytest.approx(0.004, abs=1e-6)
    (reset,) = consistent.resets
    assert msgspec.structs.astuple(reset) == pytest.approx((1.0, 1, 5.0, 2.0, 1.0))


def test_burn_in_is_not_compared(log: Path) -> None:
    assert evaluate(log, burn_in_s=100.0).compared == 501


def test_without_truth_all_that_needs_none(log: Path, tmp_path: Path) -> None:
    e = evaluate(rewritten(log, tmp_path / "x.mcap", without=("/truth",)))
    assert (e.accuracy, e.consistency, e.compared, e.without_truth) == (None, None, 0, 3001)
    assert [o.drift for o in e.outages] == [None, None]
    assert [o.duration_s for o in e.outages] == pytest.approx([10.0, 32.0])
    assert e.distance_m > 600
    assert e.aids
    assert "no truth: nothing can be said about errors" in e.notes


def test_without_aid_status_the_health_reports_the_outages(log: Path, consistent: Evaluation, tmp_path: Path) -> None:
    e = evaluate(rewritten(log, tmp_path / "x.mcap", without=("/landfix/aid_status",)))
    assert [o.duration_s for o in e.outages] == pytest.approx([o.duration_s for o in consistent.outages], abs=0.3)
    assert e.notes == ("no /landfix/aid_status: outages are found from the health alone",)


def test_gaps_in_the_truth_are_not_filled(log: Path, tmp_path: Path) -> None:
    """GIVEN 10 s without truth, and truth before and behind the estimate, THEN nothing is compared there, and it is counted."""
    with LogReader(log) as reader:
        kept = [r for r in reader if r.topic == "/truth" and not 40 * S < r.log_time_ns - EPOCH_NS < 50 * S]
    early = [encode_truth(EPOCH_NS - k * S, *truth_at(0.0)) for k in (1, 2, 3)]
    extra = [(r.topic, r.schema, r.data, r.log_time_ns) for r in kept] + [(*e, EPOCH_NS) for e in early]
    e = evaluate(rewritten(log, tmp_path / "x.mcap", without=("/truth",), extra=tuple(extra)))
    assert (e.truth_samples, e.compared, e.without_estimate) == (len(kept) + 3, len(kept), 3)
    assert e.without_truth == pytest.approx(250, abs=3)


def test_truth_of_another_rate_meets_an_interpolated_estimate(log: Path, consistent: Evaluation, tmp_path: Path) -> None:
    """GIVEN truth at 7 Hz, between the estimate's stamps, THEN the errors are those of the full comparison."""
    stamps = [EPOCH_NS + k * S // 7 for k in range(1, 830)]
    truth = tuple((*encode_truth(t, *truth_at((t - EPOCH_NS) * 1e-9)), t) for t in stamps)
    e = evaluate(rewritten(log, tmp_path / "x.mcap", without=("/truth",), extra=truth))
    assert e.compared == len(truth)
    assert e.accuracy is not None
    assert consistent.accuracy is not None
    assert e.accuracy.position_m.rmse == pytest.approx(consistent.accuracy.position_m.rmse, rel=0.03)
    assert e.accuracy.attitude_deg.rmse == pytest.approx(consistent.accuracy.attitude_deg.rmse, rel=0.05)


def test_a_hidden_gnss_receiver_serves_as_truth(log: Path, consistent: Evaluation, tmp_path: Path) -> None:
    """GIVEN 5 Hz GNSS of 1 m noise on a topic of its own, THEN its noise is not held against the estimate."""
    rng = np.random.default_rng(3)
    fixes = []
    for k in range(600):
        t_ns = EPOCH_NS + k * S // 5
        p = truth_at(k * 0.2)[0] + rng.normal(size=3)
        fixes.append((*encode_input(GnssFix(t_ns, t_ns, *geodetic(p), np.eye(3), topic="/gnss_hidden")), t_ns))
    e = evaluate(rewritten(log, tmp_path / "x.mcap", extra=tuple(fixes)), "/gnss_hidden")
    assert e.compared == 600
    assert e.accuracy is not None
    assert e.consistency is not None
    assert consistent.accuracy is not None
    assert e.accuracy.position_m.rmse == pytest.approx(np.hypot(consistent.accuracy.position_m.rmse, np.sqrt(3.0)), rel=0.08)
    assert e.accuracy.attitude_deg.n == 0
    assert e.consistency.position.mean == pytest.approx(1.0, abs=0.15)
    assert e.notes == ("the truth has no attitude",)


def test_the_first_message_with_a_stamp_counts(log: Path, consistent: Evaluation, tmp_path: Path) -> None:
    """GIVEN all stamps published again with the truth itself, THEN no error gets smaller."""
    with LogReader(log) as reader:
        again = tuple(("/landfix/odometry", r.schema, r.data, r.log_time_ns) for r in reader if r.topic == "/truth")
    e = evaluate(rewritten(log, tmp_path / "x.mcap", extra=again))
    assert e.accuracy == consistent.accuracy


def test_only_the_last_decision_on_a_measurement_counts(log: Path, consistent: Evaluation, tmp_path: Path) -> None:
    gated = next(a for a in read(log).aids if a.reason is Reason.GATED)
    revised = msgspec.structs.replace(gated, reason=Reason.FUSED, revision=1)
    extra = tuple((*encode(revised)[0], t) for t in (EPOCH_NS + 121 * S,))
    (aid,) = evaluate(rewritten(log, tmp_path / "x.mcap", extra=extra)).aids
    assert aid.revised == 1
    assert aid.reasons["gated"] == consistent.aids[0].reasons["gated"] - 1
    assert sum(aid.reasons.values()) == sum(consistent.aids[0].reasons.values())


def test_fixes_are_reported_from_each_other(log: Path) -> None:
    fixes = read(log).fixes["/pose_fix"]
    truth = np.array([truth_at((t - EPOCH_NS) * 1e-9)[0] for t in fixes.t_ns.tolist()])[:, [1, 0, 2]] * [1, 1, -1]
    wrong = np.linalg.norm(fixes.p - truth, axis=1) > 5
    assert wrong.sum() == 8
    np.testing.assert_array_equal(fixes.used, ~wrong)


def aid(t_s: float, topic: str = "/a", kind: str = "pose", reason: Reason = Reason.FUSED, late_s: float = 0.0) -> AidStatus:
    t_ns = EPOCH_NS + round(t_s * S)
    return AidStatus(t_ns, t_ns + round(late_s * S), topic, kind, reason)


def seconds(spans: list[tuple[int, int]]) -> list[tuple[float, float]]:
    return [((a - EPOCH_NS) / S, (b - EPOCH_NS) / S) for a, b in spans]


def test_outages_are_reported_by_source_and_of_all() -> None:
    """GIVEN /a silent over 10-20 s and /b over 15-40 s, THEN each has its outage and both together 15-20 s."""
    estimate = decode(schemas.ODOMETRY, [encode_truth(EPOCH_NS + k * S, *truth_at(k)).data for k in range(41)], [0] * 41)
    a = [aid(t) for t in range(41) if not 10 < t < 20]
    b = [aid(t, "/b", "gnss_position") for t in range(41) if not 15 < t < 40]
    velocity = [aid(t, "/c", "gnss_velocity") for t in range(41)]
    gated = [aid(17, reason=Reason.GATED)]
    outages = {name: seconds(of.spans) for name, of in find_outages(a + b + velocity + gated, [], estimate).items()}
    assert outages == {"all": [(15.0, 20.0)], "/a": [(10.0, 20.0)], "/b": [(15.0, 40.0)]}
    assert seconds(find_outages(a + b, [], estimate, longer_than_s=6.0)["all"].spans) == []
    late = [aid(t, late_s=1.5) for t in range(41) if not 10 < t < 20]
    assert seconds(find_outages(late, [], estimate)["all"].spans) == [(10.0, 21.5)]
    assert seconds(find_outages(gated, [], estimate)["all"].spans) == [(0.0, 40.0)]
    assert seconds(find_outages([], [], estimate)["all"].spans) == []  # nothing to go by
    health = [HealthPoint(EPOCH_NS + t * S, "aided", max(0.0, t - 30.0)) for t in range(41)]
    assert seconds(find_outages([], health, estimate)["all"].spans) == [(30.0, 40.0)]


def test_a_slow_source_does_not_wait_by_the_clock_of_a_fast_one() -> None:
    """GIVEN /gnss at 10 Hz up to 20 s and landmark fixes each 4 s but for 40 to 70 s, THEN only these 30 s are without both."""
    estimate = decode(schemas.ODOMETRY, [encode_truth(EPOCH_NS + k * S, *truth_at(k)).data for k in range(101)], [0] * 101)
    gnss = [aid(0.1 * k, "/gnss", "gnss_position") for k in range(201)]
    landmarks = [aid(t, "/landfix/fix") for t in range(0, 101, 4) if not 40 < t < 70]
    outages = find_outages(gnss + landmarks, [], estimate)
    assert {name: (of.longer_than_s, seconds(of.spans)) for name, of in outages.items()} == {
        "all": (2.0, [(40.0, 72.0)]),
        "/gnss": (2.0, [(20.0, 100.0)]),
        "/landfix/fix": (12.0, [(40.0, 72.0)]),
    }


def test_velocity_errors_are_judged_along_the_body(log: Path) -> None:
    collected = read(log)
    c = compare(collected.estimate, collected.truth)
    np.testing.assert_allclose(c.v_error, c.truth.v_body - c.estimate.v_body)
    assert np.abs(c.v_error).max() < 2.0


def test_nothing_is_compared_where_the_estimate_is_silent_or_not_finite(log: Path) -> None:
    """GIVEN an estimate silent for 1 s from 40 s and not finite at 50 s, THEN the hole is left out, the short one bridged."""
    collected = read(log)
    t = (collected.estimate.t_ns - EPOCH_NS) / S
    estimate = collected.estimate[(t <= 40) | (t >= 41)]
    estimate.p[estimate.t_ns == EPOCH_NS + 50 * S] = np.nan
    c = compare(estimate, collected.truth)
    assert c.left_out == 24
    assert np.isfinite(c.p_error).all()
    assert EPOCH_NS + 50 * S in c.t_ns


def test_the_jump_at_the_end_of_an_outage_is_not_called_aided(log: Path) -> None:
    """GIVEN a fix between two estimates, THEN a truth between it and the second, where both are mixed, is not aided."""
    collected = read(log)
    aids = tuple(msgspec.structs.replace(a, t_ns=a.t_ns - S // 100, arrived_ns=a.arrived_ns - S // 100) for a in collected.aids)
    truth = collected.truth[2247:2248]  # at 89.88 s
    for t_s, aided in ((89.995, 0), (91.0, 1)):
        moved = replace(truth, t_ns=np.array([EPOCH_NS + round(t_s * S)]))
        accuracy = assess(replace(collected, aids=aids, truth=moved), "log").accuracy
        assert accuracy is not None
        assert (accuracy.position_m.n, accuracy.aided_position_m.n) == (1, aided)


def test_an_estimate_that_is_not_finite_is_left_out_and_reported(log: Path, tmp_path: Path) -> None:
    nan = encode_truth(EPOCH_NS + 10_000_000, (np.nan, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    extra = (("/landfix/odometry", nan.schema, nan.data, EPOCH_NS + 121 * S),)
    e = evaluate(rewritten(log, tmp_path / "x.mcap", extra=extra))
    assert e.accuracy is not None
    assert np.isfinite(e.accuracy.position_m.rmse)
    assert e.notes == ("1 estimates are not finite",)


def test_bad_files_and_topics_give_one_clear_line(log: Path, tmp_path: Path) -> None:
    own = ("/landfix/odometry", "/landfix/health", "/landfix/aid_status")
    with pytest.raises(LogError, match="landfix replay"):
        evaluate(rewritten(log, tmp_path / "no_estimate.mcap", without=own))
    with pytest.raises(NoEstimateError, match="made no estimate of it"):
        evaluate(rewritten(log, tmp_path / "nothing.mcap", without=own[:1]))
    with pytest.raises(LogError, match="holds no /nothing"):
        evaluate(log, "/nothing")
    with pytest.raises(LogError, match="/landfix/aid_status cannot serve as truth"):
        evaluate(log, "/landfix/aid_status")
    with pytest.raises(LogError):
        evaluate(tmp_path / "absent.mcap")


def test_messages_that_make_no_sense_are_counted(log: Path, tmp_path: Path) -> None:
    types = {"aid_status": schemas.AID_STATUS, "health": schemas.DIAGNOSTICS, "odometry": schemas.ODOMETRY}
    junk = tuple((f"/landfix/{name}", schema, b"\0\1\0\0junk", EPOCH_NS + 121 * S) for name, schema in types.items())
    e = evaluate(rewritten(log, tmp_path / "x.mcap", extra=junk))
    assert e.estimates == 3001
    assert e.notes == ("2 messages could not be read",)


def test_a_torn_log_is_evaluated_as_far_as_it_goes(log: Path, tmp_path: Path) -> None:
    data = log.read_bytes()
    (tmp_path / "torn.mcap").write_bytes(data[: len(data) // 2])
    e = evaluate(tmp_path / "torn.mcap")
    assert 0 < e.estimates < 3001
    assert e.notes[0] == "the log is truncated: read to its last whole record"


def test_json_holds_all_of_it(consistent: Evaluation) -> None:
    text = msgspec.json.encode(consistent)
    assert b"NaN" not in text
    back = msgspec.json.decode(text)
    assert back["accuracy"]["position_m"]["rmse"] == pytest.approx(
        consistent.accuracy.position_m.rmse if consistent.accuracy else None
    )
    assert back["consistency"]["position"]["dof"] == 3
    assert len(back["outages"]) == 2


def test_the_table_reports_what_the_record_holds(consistent: Evaluation) -> None:
    out = io.StringIO()
    print_table(consistent, Console(file=out, width=80, no_color=True))
    text = out.getvalue()
    for word in ("3001 estimates", "Accuracy", "aligned, SE(3)", "Consistency", "Outages", "/pose_fix", "gated 8", "Resets"):
        assert word in text
    assert "…" not in text  # everything fits a narrow terminal
    named = msgspec.structs.replace(consistent, aids=(msgspec.structs.replace(consistent.aids[0], topic="[/x]"),))
    print_table(named, Console(file=out))  # a topic is no markup
    assert "[/x]" in out.getvalue()


def test_the_table_needs_no_truth(log: Path, tmp_path: Path) -> None:
    out = io.StringIO()
    print_table(evaluate(rewritten(log, tmp_path / "x.mcap", without=("/truth",))), Console(file=out, width=80))
    assert "note: no truth" in out.getvalue()


@long.parametrize(("sequence", "rmse_m", "median_deg"), [("V1_02_medium", 0.06, 1.8), ("MH_04_difficult", 0.17, 0.8)])
def test_a_real_flight_with_nothing_but_poses(
    landfix_data: Path, tmp_path: Path, sequence: str, rmse_m: float, median_deg: float
) -> None:
    """GIVEN EuRoC's visual poses at 20 Hz and no report next to them, THEN the figures are those that its README has."""
    flight_log.write_vision(tmp_path / "vision.mcap", landfix_data / "flights" / "euroc" / sequence)
    e = evaluate(tmp_path / "vision.mcap")
    assert e.accuracy is not None
    assert e.accuracy.position_m.rmse == pytest.approx(rmse_m, abs=0.006)
    assert e.accuracy.attitude_deg.median == pytest.approx(median_deg, abs=0.1)
    assert e.accuracy.se3_aligned_m.rmse <= e.accuracy.position_m.rmse
    assert (e.modes, e.aids, e.resets, e.outages) == ({}, (), (), ())
    assert e.notes == ("neither /landfix/aid_status nor /landfix/health: outages are not known",)
    assert e.compared > 0.9 * e.duration_s * 200


def test_estimates_without_an_attitude_are_finite_and_their_positions_count(log: Path) -> None:
    """GIVEN a heading that is not known from 40 s to 60 s (a variance of 12 rad^2, "not given" on the wire)."""
    collected = read(log)
    unknown = (collected.estimate.t_ns >= EPOCH_NS + 40 * S) & (collected.estimate.t_ns < EPOCH_NS + 60 * S)
    collected.estimate.covariance[unknown, 5, 5] = 12.0
    collected.estimate.q_wxyz[unknown] = np.nan
    e, whole = assess(collected, "unknown heading"), evaluate(log)
    assert e.compared == whole.compared
    assert e.notes == (f"{np.count_nonzero(unknown)} estimates have no attitude that is known: of these the position counts",)
    assert e.accuracy is not None
    assert whole.accuracy is not None
    assert e.accuracy.position_m == whole.accuracy.position_m
    assert e.accuracy.attitude_deg.n == whole.accuracy.attitude_deg.n - np.count_nonzero(unknown)
    assert e.accuracy.velocity_m_s.n == e.accuracy.attitude_deg.n
    assert np.isfinite(e.accuracy.velocity_m_s.rmse)


def test_a_long_log_is_thinned_and_judged_alike(log: Path, consistent: Evaluation, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 3001 estimates at 25 Hz every 16th is left: 0.64 s apart, no hole."""
    monkeypatch.setattr("logs.evaluation.evaluate.MOST", 200)
    thinned = evaluate(log)
    assert (thinned.estimates, thinned.compared, thinned.without_estimate) == (3001, 188, 0)
    assert thinned.notes == ("errors are computed from one of 16 estimates",)
    assert thinned.accuracy is not None
    assert consistent.accuracy is not None
    assert thinned.accuracy.position_m.rmse == pytest.approx(consistent.accuracy.position_m.rmse, rel=0.2)
