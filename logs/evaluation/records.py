"""Results of an evaluation as JSON-ready records (nan: null)."""

import msgspec

from logs.evaluation.integrity import IntegritySummary
from logs.evaluation.metrics import Consistency, Drift, Stats


class RelativeError(msgspec.Struct, frozen=True):
    """Relative pose error over a time or distance ("10 s", "100 m")."""

    over: str
    translation_m: Stats
    rotation_deg: Stats


class Accuracy(msgspec.Struct, frozen=True):
    """Errors against the truth; position_m: unaligned, *_aligned_m: yaw and shift, rigid, similarity.

    aided_*: outside outages; tilt_deg, heading_deg; n = 0: not in the truth.
    """

    position_m: Stats
    horizontal_m: Stats
    vertical_m: Stats
    aided_position_m: Stats
    yaw_aligned_m: Stats
    se3_aligned_m: Stats
    sim3_aligned_m: Stats
    sim3_scale: float
    attitude_deg: Stats
    aided_attitude_deg: Stats
    tilt_deg: Stats
    heading_deg: Stats
    velocity_m_s: Stats
    relative: tuple[RelativeError, ...]


class ConsistencySummary(msgspec.Struct, frozen=True):
    """NEES of each part; share inside the 95 % horizontal radius, and that radius."""

    position: Consistency
    position_aided: Consistency
    position_outages: Consistency
    attitude: Consistency
    velocity: Consistency
    pose: Consistency
    radius95_covered: float
    radius95_median_m: float
    radius95_max_m: float


class Outage(msgspec.Struct, frozen=True):
    """A span without absolute information of a source or "all"; start_s from the first estimate.

    Without truth drift and the following are None; nees_position: mean NEES / 3; increments: fused odometry; without_odometry_m:
    final error without.
    """

    source: str
    start_s: float
    duration_s: float
    drift: Drift | None
    attitude_rmse_deg: float | None
    attitude_end_deg: float | None
    nees_position: float | None
    radius95_end_m: float | None
    increments: int = 0
    without_odometry_m: float | None = None


class Percentiles(msgspec.Struct, frozen=True):
    """Median, 95 %, 99 % and maximum."""

    p50: float
    p95: float
    p99: float
    max: float


class AidSummary(msgspec.Struct, frozen=True):
    """Decisions on a source's measurements of a kind.

    revised: changed later; nis, test_ratio: of the fused, 1 is the gate.
    """

    topic: str
    kind: str
    reasons: dict[str, int]
    revised: int
    nis: float | None
    test_ratio: Percentiles | None
    delay_s: Percentiles | None


class ResetRow(msgspec.Struct, frozen=True):
    """A jump of the estimate, t_s from the first."""

    t_s: float
    counter: int
    position_m: float
    velocity_m_s: float
    attitude_deg: float


class Evaluation(msgspec.Struct, frozen=True):
    """compared, without_estimate: truth samples; without_truth: estimates; modes: shares of time."""

    log: str
    compared_with: str  # "truth", or "reference (the autopilot's own estimate)"
    duration_s: float
    estimates: int
    distance_m: float
    truth_samples: int
    compared: int
    without_estimate: int
    without_truth: int
    modes: dict[str, float]
    without_absolute_s: float
    accuracy: Accuracy | None
    consistency: ConsistencySummary | None
    outages: tuple[Outage, ...]
    outage_thresholds_s: dict[str, float]  # source -> a longer wait is an outage
    aids: tuple[AidSummary, ...]
    latency_s: dict[str, Percentiles]
    resets: tuple[ResetRow, ...]
    notes: tuple[str, ...]
    integrity: IntegritySummary | None = None
