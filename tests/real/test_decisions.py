"""Cut flights whose faults locked true fixes out, next to the folder of the flights: each with the error that it may cost."""

import os
from pathlib import Path

import msgspec
import numpy as np
import pytest

from benchmarks.flights.tasks import INSIDE95, read_odometry
from benchmarks.integrity.runs import outputs_of
from estimator.config import load
from estimator.fusion import Fusion
from logs.store.reader import LogReader
from logs.wire.codec import Decoder, Topics
from models.frames import ENU_FROM_NED
from models.messages import Estimate, Reset
from models.state import E, X
from tests import long

ROOT = Path(__file__).parents[2]
CASES = Path(os.environ.get("LANDFIX_DATA", ROOT.parent / "shared" / "data")).parent / "cases"


def _case(name: str) -> Path:
    path = CASES / f"{name}.mcap"
    if not path.is_file():
        pytest.skip(f"{path.name} not found: set LANDFIX_DATA to the folder of recorded flights")
    return path


def _flown(path: Path) -> tuple[dict[int, Estimate], int]:
    """Estimates by stamp, the first of each, and the number of resets."""
    config = load(path.with_suffix(".toml"))
    decoder = Decoder(Topics.of(msgspec.to_builtins(config.inputs)), config.mounting())
    with LogReader(path) as reader:
        messages = (decoder.decode(r.topic, r.schema, r.data, r.log_time_ns) for r in reader)
        estimates, others = outputs_of(Fusion(config.fusion()), (m for m in messages if m is not None))
    return estimates, sum(isinstance(output, Reset) for output in others)


def test_a_hostile_position_that_is_gated_moves_nothing() -> None:
    """It had led for 0.11 s, 528 m off in height."""
    estimates, resets = _flown(_case("attacks/hostile_gnss_528m"))
    p_n = np.array([estimates[t].nav[X.P] for t in sorted(estimates)])
    assert resets == 0
    assert np.abs(np.diff(p_n, axis=0)).max() < 5.0


@long.parametrize(
    ("case", "rmse_m", "covered"),
    [
        ("decisions/stk_imu_holds_1s", 0.5, 0.9),
        ("decisions/la3_three_lookalikes", 4.5, 0.9),  # three seconds of 13 m
        ("decisions/frz_pose_repeats_indoor", 0.6, 0.9),
        ("decisions/frz_pose_repeats_outdoor", 0.7, 0.9),
        ("decisions/gf0_gnss_freezes_20s", 7.0, 0.9),
        ("decisions/clk_fix_clock_gains_2ms_s", 2.0, 0.4),  # no worse than the plain filter; the delay is not covered
    ],
    one_in=2,
)
def test_true_fixes_lead_again(case: str, rmse_m: float, covered: float) -> None:
    path = _case(case)
    estimates, _ = _flown(path)
    truth = read_odometry(path, "/truth")
    stamps = np.array(sorted(estimates))
    nearest = stamps[np.clip(np.searchsorted(stamps, truth.t_ns), 0, len(stamps) - 1)]
    known = np.abs(nearest - truth.t_ns) < 20_000_000
    found = [estimates[t] for t in nearest[known].tolist()]
    off = np.array([e.nav[X.P] for e in found]) - (truth.p @ ENU_FROM_NED.T)[known]
    reach = np.sqrt(INSIDE95 * np.linalg.eigvalsh([e.covariance[E.P, E.P] for e in found])[:, -1])
    size = np.linalg.norm(off, axis=1)
    assert known.mean() > 0.95  # but for the alignment there is always an estimate
    assert np.sqrt(np.mean(size**2)) < rmse_m
    assert np.mean(size < reach) > covered
