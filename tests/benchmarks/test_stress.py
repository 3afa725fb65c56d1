"""The perturbations of the stress table do what they say, and the table has a row for every cell."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.stress import perturbations as perturb
from benchmarks.stress import sensors
from benchmarks.stress.__main__ import jobs
from benchmarks.stress.cell import Row, Score, landfix, naive, score
from benchmarks.stress.flights import Flight, load_flight
from benchmarks.stress.perturbations import KINDS
from benchmarks.stress.report import failures, stress_table
from models.frames import Origin
from models.messages import GnssFix, GnssVelocity, ImuSample, Input, OdometryPose, PoseFix, Reading


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    return load_flight("sim/rotor", "both", 0, tmp_path_factory.mktemp("tasks"))


def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def fixes(messages: list[Input]) -> list[PoseFix]:
    return [m for m in messages if isinstance(m, PoseFix)]


def imu(messages: list[Input]) -> list[ImuSample]:
    return [m for m in messages if isinstance(m, ImuSample)]


def gnss_p(messages: list[Input], flight: Flight) -> np.ndarray:
    origin = Origin.of(flight.config.origin)
    assert origin is not None
    return np.array([origin.to_ned(m.lat_deg, m.lon_deg, m.alt_m) for m in messages if isinstance(m, GnssFix)])


def gnss_v(messages: list[Input]) -> np.ndarray:
    return np.array([m.v_n for m in messages if isinstance(m, GnssVelocity)])


OTHER_FIXES = "fixes 20 Hz correlated"  # at any size


@pytest.mark.parametrize("kind", [k for k in KINDS.values() if k.name != OTHER_FIXES], ids=lambda k: k.name)
def test_size_nothing_changes_no_value(flight: Flight, kind: perturb.Kind) -> None:
    size = 1.0 if kind.unit == "x" and kind.perturb is not perturb.fix_drift else 0.0
    made = kind.perturb(flight, size, rng())
    after = [m for m in made if not isinstance(m, Reading | OdometryPose) and m.topic != sensors.ANOTHER]  # that a sensor adds
    assert [(m.t_ns, m.topic) for m in after] == [(m.t_ns, m.topic) for m in flight.messages]
    for name in ("gyro_b", "accel_b", "p_n", "q_nb_wxyz", "v_n", "lat_deg", "lon_deg", "alt_m", "covariance"):
        new, old = (np.array([getattr(m, name) for m in some if hasattr(m, name)]) for some in (after, flight.messages))
        np.testing.assert_allclose(new, old, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("size_m", [0.0, 20.0])
def test_another_source_of_fixes_has_noise_of_its_own_and_is_off_by_its_size(flight: Flight, size_m: float) -> None:
    made = [m for m in sensors.second_shifted(flight, size_m, rng()) if m.topic == sensors.ANOTHER]
    assert len(made) == len(fixes(flight.messages))
    off = np.array([np.array(m.p_n) - flight.p_n[flight.row(m.t_ns)] for m in made if isinstance(m, PoseFix)])
    assert np.linalg.norm(off.mean(axis=0)) == pytest.approx(size_m, abs=0.1)
    assert off.std(axis=0) == pytest.approx(np.sqrt(np.diag(fixes(flight.messages)[0].covariance)[:3]), rel=0.3)
    assert abs(np.corrcoef(off[:, 0], [m.p_n[0] - flight.p_n[flight.row(m.t_ns), 0] for m in fixes(flight.messages)])[0, 1]) < 0.4


def test_mount_turns_both_sensors_by_its_angle(flight: Flight) -> None:
    before, after = imu(flight.messages)[500:1500], imu(perturb.imu_mount(flight, 3.0, rng()))[500:1500]
    both = [np.array([m.gyro_b for m in s] + [m.accel_b for m in s]) for s in (before, after)]
    turn, _ = Rotation.align_vectors(both[1], both[0])
    assert np.degrees(turn.magnitude()) == pytest.approx(3.0, abs=1e-3)
    np.testing.assert_allclose(turn.apply(both[0]), both[1], atol=1e-6)


def test_fix_delay_moves_stamp_and_arrival_and_keeps_the_order_of_arrival(flight: Flight) -> None:
    late = perturb.fix_delay(flight, 80.0, rng())
    assert [m.t_ns - n.t_ns for m, n in zip(fixes(late), fixes(flight.messages), strict=True)] == [80_000_000] * len(fixes(late))
    assert [m.arrived_ns for m in late] == sorted(m.arrived_ns for m in late)


def test_fix_covariance_shrinks(flight: Flight) -> None:
    after = fixes(perturb.fix_covariance(flight, 16.0, rng()))[0]
    np.testing.assert_allclose(after.covariance * 16.0, fixes(flight.messages)[0].covariance)


def test_drift_has_its_size_and_is_slow(flight: Flight) -> None:
    runs = [fixes(perturb.fix_drift(flight, 1.0, np.random.default_rng(k))) for k in range(30)]
    course = np.array([np.subtract([m.p_n for m in run], [m.p_n for m in fixes(flight.messages)]) for run in runs])
    assert course.std() == pytest.approx(perturb.DRIFT_M, rel=0.25)
    assert np.diff(course, axis=1).std() < 0.2 * perturb.DRIFT_M


def test_clipping_only_in_bursts_and_never_beyond_the_limit(flight: Flight) -> None:
    after = imu(perturb.clipping(flight, 0.3, rng()))
    changed = [m for m, n in zip(after, imu(flight.messages), strict=True) if m is not n]
    assert {round((m.t_ns - flight.start_ns) * 1e-9) % 10 for m in changed} == {0}
    assert np.abs([m.accel_b for m in changed]).max() == pytest.approx(perturb.CLIP_M_S2)
    assert len(changed) == pytest.approx(0.03 * len(after), rel=0.05)


def test_lost_samples(flight: Flight) -> None:
    kept = imu(perturb.imu_drop(flight, 5.0, rng()))
    assert len(kept) / len(imu(flight.messages)) == pytest.approx(0.95, abs=0.01)


def test_jitter_keeps_each_topic_in_order_and_is_never_early(flight: Flight) -> None:
    after = perturb.time_jitter(flight, 15.0, rng())
    samples = imu(after)
    late = np.array([m.t_ns - n.t_ns for m, n in zip(samples, imu(flight.messages), strict=True)])
    assert (np.diff([m.t_ns for m in samples]) > 0).all()
    assert late.min() >= 0
    assert 5_000_000 < late.mean() < 15_000_000


def test_pulled_velocity_is_the_rate_of_the_pulled_position(flight: Flight) -> None:
    after = perturb.gnss_pull(flight, 3.0, rng())
    moved = np.linalg.norm(gnss_p(after, flight) - gnss_p(flight.messages, flight), axis=1)
    faster = np.linalg.norm(gnss_v(after) - gnss_v(flight.messages), axis=1)
    assert moved[: int(5 * perturb.ONSET_S)].max() < 1e-6
    assert moved[-1] == pytest.approx(3.0 * 40.0, abs=1.0)
    assert faster[-1] == pytest.approx(3.0)
    assert faster[0] == 0.0


@pytest.mark.parametrize(
    ("change", "size"), [(perturb.gnss_boot, 200.0), (perturb.height_datum, 19.4), (perturb.gnss_lever, 1.0)]
)
def test_gnss_is_off_by_its_size_throughout(flight: Flight, change: perturb.Perturb, size: float) -> None:
    off = np.linalg.norm(gnss_p(change(flight, size, rng()), flight) - gnss_p(flight.messages, flight), axis=1)
    np.testing.assert_allclose(off, size, rtol=1e-6)


def test_rarer_fixes_begin_when_asked_and_keep_their_distance(flight: Flight) -> None:
    seconds = [(m.t_ns - flight.start_ns) * 1e-9 for m in fixes(perturb.rarer(flight.messages, 5.0, 20.0))]
    assert seconds[0] == pytest.approx(20.0, abs=0.5)
    np.testing.assert_allclose(np.diff(seconds), 5.0, atol=0.01)


def test_the_score_of_an_unperturbed_flight_and_of_silence(flight: Flight) -> None:
    ours, plain = score(landfix(flight.messages, flight)[0], flight, 10.0), score(naive(flight.messages, flight), flight, 10.0)
    assert ours.complete
    assert plain.complete
    assert ours.rmse_m is not None
    assert ours.rmse_m < 0.3
    assert ours.overconfident == 0.0
    assert not score([], flight, 10.0).complete


@pytest.mark.parametrize("quick", [True, False])
def test_the_table_has_a_row_for_every_cell(*, quick: bool) -> None:
    one = Score(complete=True, rmse_m=0.2, attitude_deg=1.0, end_m=0.2, overconfident=0.0, inside95=0.95)
    work = jobs(["sim/rotor", "sim/wing"], list(KINDS), [0, 1], Path("out"), quick=quick)
    rows = [Row(kind, size, name, seed, one, one, 0, {}) for name, kind, size, seed, _ in work]
    wanted = [(k.name, f"{s:g} {k.unit}".strip()) for k in KINDS.values() for s in (k.sizes[-2:] if quick else k.sizes)]
    assert [line[:3] for line in stress_table(rows).rows] == [(*cell, "4") for cell in wanted]


def test_a_run_fails_by_each_criterion() -> None:
    good = Score(complete=True, rmse_m=0.2, attitude_deg=1.0, end_m=0.2, overconfident=0.0, inside95=0.95)
    worse = Score(complete=True, rmse_m=0.31, attitude_deg=1.0, end_m=0.2, overconfident=0.02, inside95=0.5)
    poor = Score(complete=True, rmse_m=1.1, attitude_deg=1.0, end_m=0.2)

    def row(ours: Score, plain: Score) -> Row:
        return Row("fix delay", 80.0, "sim/rotor", 0, ours, plain, 0, {})

    assert failures(row(good, good)) == []
    assert failures(row(worse, good)) == ["ratio", "overconfident"]
    assert failures(row(worse, poor)) == ["overconfident"]
    assert failures(row(Score(complete=False), good)) == ["incomplete"]
    alone = Row("GNSS slow error", 1.0, "sim/rotor", 0, worse, good, 0, {})  # the plain filter fuses no GNSS position
    assert failures(alone) == ["overconfident"]
