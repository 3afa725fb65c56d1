"""Messages: immutable, NED, FRD, SI, radians.

`t_ns`: validity, `arrived_ns`: arrival; `topic`: source. Wire form: logs/wire/codec.py.
"""

import math
from enum import IntEnum, StrEnum
from typing import Any, Final, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

Vec3: TypeAlias = tuple[float, float, float]
Quat: TypeAlias = tuple[float, float, float, float]
Array: TypeAlias = NDArray[np.float64]

ATTITUDE_TOPIC: Final = "/attitude"  # of an autopilot's estimate, unless configured otherwise
ODOMETRY_DELTA_TOPIC: Final = "/landfix/odometry_delta"
_HIGHEST_M: Final = 50_000.0  # that a receiver gives a position at
RADIAN_M: Final = 50.0  # metres that count as much as a radian where position and attitude are mixed: a landmark's distance


class ImuSample(msgspec.Struct, frozen=True, eq=False):
    """Inertial sample in body axes (FRD).

    gyro_b: rad/s; accel_b: specific force, m/s^2 (level at rest: 0, 0, -9.8).
    """

    t_ns: int
    arrived_ns: int
    gyro_b: Vec3
    accel_b: Vec3
    topic: str = "/imu"


class ReceiverState(IntEnum):
    """A GNSS receiver's report of interference; the largest applies."""

    UNKNOWN = 0  # or nothing to report
    JAMMED = 1  # or a spoofing signal that it mitigates
    SPOOFED = 2


class GnssFix(msgspec.Struct, frozen=True, eq=False):
    """Antenna position, WGS-84; alt_m above the ellipsoid.

    covariance_n: (3, 3) m^2 NED or None; status < 0: no fix; state: receiver flags.
    """

    t_ns: int
    arrived_ns: int
    lat_deg: float
    lon_deg: float
    alt_m: float
    covariance_n: Array | None
    status: int = 0
    topic: str = "/gnss"
    state: ReceiverState = ReceiverState.UNKNOWN

    @property
    def is_on_earth(self) -> bool:
        """As on_earth."""
        return on_earth(self.lat_deg, self.lon_deg, self.alt_m)


class GnssVelocity(msgspec.Struct, frozen=True, eq=False):
    """Antenna velocity v_n, m/s; covariance_n (3, 3) m^2/s^2 or None."""

    t_ns: int
    arrived_ns: int
    v_n: Vec3
    covariance_n: Array | None
    topic: str = "/gnss/velocity"


class PoseFix(msgspec.Struct, frozen=True, eq=False):
    """External position and attitude of the body in the map frame.

    covariance (6, 6): x y z rx ry rz NED, R_true = exp(dtheta_n) @ R_measured; >= 9e4 m^2, >= 10 rad^2, NaN, negative: not given.
    covariance_common: systematic part, in addition.
    """

    t_ns: int
    arrived_ns: int
    p_n: Vec3
    q_nb_wxyz: Quat
    covariance: Array
    covariance_common: Array | None = None
    topic: str = "/pose_fix"


class LandmarkFix(msgspec.Struct, frozen=True, eq=False):
    """A PoseFix of our vision.

    landmarks: identifiers; similarity: 0..1 (thesis eq. 5.5); residual_px: RMS of the fit. Where known, landmark_errors (m, 6, k)
    = L_j: effect of k unit errors of each; covariance_rig (6, 6):

        covariance_common = sum_j L_j L_j^T + covariance_rig

    directions: D (r, 6), measured combinations of xi = (dp_n, dtheta_n), orthonormal, a radian as RADIAN_M; None: the pose.
    readings: y (r,) m:

        D (x_true (-) x_fix) = y + v,   v ~ N(0, D (covariance + covariance_common) D^T)
    """

    t_ns: int
    arrived_ns: int
    p_n: Vec3
    q_nb_wxyz: Quat
    covariance: Array
    covariance_common: Array | None
    landmarks: tuple[str, ...]
    similarity: float
    residual_px: float
    landmark_errors: Array | None = None
    covariance_rig: Array | None = None
    directions: Array | None = None
    readings: Array | None = None
    topic: str = "/landfix/fix"


class ImageName(msgspec.Struct, frozen=True):
    """An image by topic and exposure stamp."""

    topic: str
    t_ns: int


class VisionRequest(msgspec.Struct, frozen=True, eq=False):
    """A search for landmarks in the images of t_ns, with prior.

    covariance (6, 6): as PoseFix; run: of the vision process.
    """

    t_ns: int
    arrived_ns: int
    p_n: Vec3
    q_nb_wxyz: Quat
    covariance: Array
    left: ImageName | None
    right: ImageName | None
    run: int = 0


class OdometryRequest(msgspec.Struct, frozen=True, eq=False):
    """A request for the motion from t0_ns to t_ns in four images.

    dp_b, dq_wxyz, covariance: predicted, as OdometryDelta; first, second: left, right image; down_b: unit vector at t0; height_m
    above ground; 0: unknown.
    """

    t_ns: int
    arrived_ns: int
    t0_ns: int
    dp_b: Vec3
    dq_wxyz: Quat
    covariance: Array
    first: tuple[ImageName | None, ImageName | None]
    second: tuple[ImageName | None, ImageName | None]
    down_b: Vec3
    height_m: float = 0.0
    height_sigma_m: float = 0.0


class Reading(msgspec.Struct, frozen=True, eq=False):
    """A reading of an optional sensor.

    kind: section and [inputs] key; values (k,): SI, FRD, order of logs/wire/sensors.py.
    """

    t_ns: int
    arrived_ns: int
    topic: str
    kind: str
    values: tuple[float, ...]
    covariance: Array | None = None


class OdometryDelta(msgspec.Struct, frozen=True, eq=False):
    """Motion of the body from t0_ns to t_ns.

    dp_b = R_0^T (p_1 - p_0), m; dq_wxyz: R_01 = R_0^T R_1. covariance (6, 6): of dp_b and theta, R_01,true = R_01 exp(theta), new
    each time. systematic: J (6, k), effect of k unit errors s, constant within an epoch: dp = dp_true + J_p s, R_01 = R_01,true
    exp(J_theta s).
    """

    t_ns: int
    arrived_ns: int
    t0_ns: int
    dp_b: Vec3
    dq_wxyz: Quat
    covariance: Array
    systematic: Array | None = None
    epoch: int = 0
    topic: str = ODOMETRY_DELTA_TOPIC


class OdometryPose(msgspec.Struct, frozen=True, eq=False):
    """Pose in a drifting odometry frame: x_o = R_ob x_b + p_o; a new frame name after a jump. is_lost: there is none."""

    t_ns: int
    arrived_ns: int
    p_o: Vec3
    q_ob_wxyz: Quat
    frame: str = "odom"
    topic: str = "/odometry"
    is_lost: bool = False


class AttitudePrior(msgspec.Struct, frozen=True, eq=False):
    """Another estimator's attitude, for alignment only; covariance: (3, 3) rad^2 about n."""

    t_ns: int
    arrived_ns: int
    q_nb_wxyz: Quat
    covariance: Array
    topic: str = ATTITUDE_TOPIC


class Tick(msgspec.Struct, frozen=True, eq=False):
    """The clock of Fusion."""

    t_ns: int
    arrived_ns: int
    topic: str = "/landfix/tick"


class Checkpoint(msgspec.Struct, frozen=True, eq=False):
    """State of an earlier run; fields as Estimate, last_gnss as Health."""

    t_ns: int
    arrived_ns: int
    nav: Array
    covariance: Array
    last_absolute_ns: int
    reset_counter: int
    origin: tuple[float, float, float] | None = None
    last_gnss: "LastGnss | None" = None
    topic: str = "/landfix/checkpoint"


class Unusable(msgspec.Struct, frozen=True, eq=False):
    """A message that is no measurement, kept with its reason."""

    t_ns: int
    arrived_ns: int
    topic: str
    detail: str


Input: TypeAlias = (
    ImuSample
    | GnssFix
    | GnssVelocity
    | PoseFix
    | LandmarkFix
    | Reading
    | OdometryDelta
    | OdometryPose
    | AttitudePrior
    | Tick
    | Checkpoint
    | Unusable
)


class Mode(StrEnum):
    """What the estimate rests on."""

    STARTING = "starting"  # no plausible IMU stream yet
    ALIGNING = "aligning"  # IMU is there; position, velocity or heading are not yet known
    ALIGNING_HEADING = "aligning_heading"  # position, velocity and tilt are published, the heading is not known
    AIDED = "aided"  # an absolute source was fused within its timeout
    ODOMETRY = "odometry"  # no absolute source, but odometry was fused within 3 s
    DEAD_RECKONING = "dead_reckoning"  # IMU alone
    COASTING = "coasting"  # not even an IMU: constant velocity and turn rate


class Reason(StrEnum):
    """Why a measurement was, or was not, used."""

    FUSED = "fused"
    GATED = "gated"  # chi-square test failed
    PROBATION = "probation"  # source has just come (back); consistent, but not yet trusted
    HELD = "held"  # equals the last reading to the bit, though the vehicle moves
    STOPPED = "stopped"  # source is held off (spoofing or jamming suspected)
    ALIGNING = "aligning"  # used for, or waiting for, the initial alignment
    THINNED = "thinned"  # too soon after the last one, or a prior that is not needed any more
    TOO_OLD = "too_old"  # older than history_s
    IN_FUTURE = "in_future"  # stamped later than it arrived, beyond tolerance
    DUPLICATE = "duplicate"  # same content already there
    NOT_FINITE = "not_finite"
    NOT_PSD = "not_psd"  # covariance is asymmetric or not positive definite
    UNSUPPORTED = "unsupported"  # this combination of given components is not a measurement
    NO_FIX = "no_fix"  # the receiver or the odometry says so
    NO_ORIGIN = "no_origin"  # a geodetic measurement, and a map that is nowhere on Earth
    IMPLAUSIBLE = "implausible"  # wrong units, gravity missing, out of physical range
    UNKNOWN_TOPIC = "unknown_topic"
    MALFORMED = "malformed"
    INTERNAL = "internal"  # a defect of ours; counted, must stay 0


class AidStatus(msgspec.Struct, frozen=True, eq=False):
    """Decision on a measurement; sent again with a higher revision when changed.

    test_ratio: squared Mahalanobis distance / gate; delay_s: arrival - validity; replayed: IMU samples.
    """

    t_ns: int
    arrived_ns: int
    topic: str
    kind: str
    reason: Reason
    revision: int = 0
    innovation: tuple[float, ...] = ()
    innovation_sigma: tuple[float, ...] = ()
    test_ratio: float = 0.0
    delay_s: float = 0.0
    replayed: int = 0
    detail: str = ""


class Estimate(msgspec.Struct, frozen=True, eq=False):
    """State with all of t <= t_ns that has arrived.

    nav (16,): packed NavState (X); covariance (15, 15) (E); gyro_b: rate less bias, rad/s.
    """

    t_ns: int
    arrived_ns: int
    nav: Array
    covariance: Array
    gyro_b: Vec3
    mode: Mode
    reset_counter: int
    last_absolute_ns: int
    origin: tuple[float, float, float] | None = None  # lat_deg, lon_deg, alt_m of n's origin


class Reset(msgspec.Struct, frozen=True, eq=False):
    """A jump: new = old (+) delta; delta_theta_n about n."""

    t_ns: int
    arrived_ns: int
    counter: int
    delta_p_n: Vec3
    delta_v_n: Vec3
    delta_theta_n: Vec3


class VisionReport(msgspec.Struct, frozen=True, eq=False):
    """Result of a stereo pair, with the reason.

    outcome: fixed, or the last stage; landmarks, similarities: best of each candidate, 0..1; residual_px: RMS.
    """

    t_ns: int
    arrived_ns: int
    outcome: str
    detail: str = ""
    regions: int = 0
    candidates: int = 0
    landmarks: tuple[str, ...] = ()
    similarities: tuple[float, ...] = ()
    residual_px: float = math.nan
    processing_s: float = 0.0


class LastGnss(msgspec.Struct, frozen=True, eq=False):
    """Last trusted GNSS position, age, 1-sigma horizontal radius grown with age."""

    lat_deg: float
    lon_deg: float
    alt_m: float
    age_s: float
    sigma_m: float


class Health(msgspec.Struct, frozen=True, eq=False):
    """State of the estimator, 1-10 Hz.

    biases: gyro_x ... accel_z (FRD, rad/s, m/s^2), *_sigma, wind_north, wind_east (m/s); weights: ln, by assumption.
    """

    t_ns: int
    arrived_ns: int
    mode: Mode
    absolute_age_s: float  # since an absolute position was last fused; inf: never
    radius95_m: float  # horizontal; inf before alignment
    attitude_sigma_deg: float
    reset_counter: int
    sources: dict[str, str]  # topic -> stopped | starting | active
    counts: dict[str, int]  # reason -> measurements so far
    hypotheses: int
    last_gnss: LastGnss | None = None
    detail: str = ""
    biases: dict[str, float] = {}
    integrity: str = ""  # of the last Integrity: state, and the reason for it
    weights: dict[str, float] = {}


class Alert(StrEnum):
    """Use of the estimate against the alert limits."""

    NOT_JUDGED = "not judged"  # no alert limit is configured
    USABLE = "usable"
    CAUTION = "caution"
    DO_NOT_USE = "do not use"


class Integrity(msgspec.Struct, frozen=True, eq=False):
    """Protection levels at a stated risk, and the state.

    hpl_m, vpl_m: at risk_per_hour, inf: unbounded; hal_m, val_m: inf: none; risks_per_hour, hpls_m, vpls_m: fixed risks;
    sigma_h_m, sigma_v_m: Gaussian of the first.
    """

    t_ns: int
    arrived_ns: int
    state: Alert
    reason: str
    risk_per_hour: float
    hpl_m: float
    vpl_m: float
    hal_m: float
    val_m: float
    risks_per_hour: tuple[float, ...]
    hpls_m: tuple[float, ...]
    vpls_m: tuple[float, ...]
    sigma_h_m: float
    sigma_v_m: float


Output: TypeAlias = Estimate | AidStatus | Health | Integrity | Reset | VisionReport | VisionRequest | OdometryRequest


def on_earth(lat_deg: float, lon_deg: float, alt_m: float) -> bool:
    """Whether latitude and longitude [deg] and height [m] can be those of a vehicle."""
    return abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0 and abs(alt_m) <= _HIGHEST_M


def vec3(v: Any) -> Vec3:
    """The first three elements of v as plain floats."""
    return float(v[0]), float(v[1]), float(v[2])
