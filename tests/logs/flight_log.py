"""A log whose errors are known: truth on a circle, and an estimate whose errors are drawn from its own covariance."""

import gzip
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from logs.store.reader import LogReader
from logs.store.recorder import Recorder
from logs.wire import cdr_fast, schemas
from logs.wire.codec import encode, encode_input, encode_slow, encode_truth
from models import so3
from models.frames import Origin
from models.messages import AidStatus, Array, Estimate, Health, Mode, PoseFix, Reason, Reset, vec3
from models.state import E, X

EPOCH_NS = 1_700_000_000_000_000_000
STEP_NS = 40_000_000
FIX_EVERY = 25  # steps
ORIGIN = (47.4, 8.5, 500.0)
FIX_SIGMA, WALK = np.repeat([0.15, 0.1, 0.02], 3), np.repeat([0.3, 0.05, 0.004], 3)  # p, v, theta; units and units/sqrt(s)


@dataclass(frozen=True)
class Flight:
    """What goes into the log. error_scale: 1 is consistent; outages in s."""

    duration_s: float = 120.0
    outages: tuple[tuple[float, float], ...] = ((20.0, 30.0), (60.0, 90.0))
    error_scale: float = 1.0
    delay_s: float = 0.004
    false_every: int = 10
    truth: bool = True
    truth_every: int = 1
    aid_status: bool = True
    seed: int = 1


def truth_at(t: float) -> tuple[Array, Array, Array]:
    """p_n, v_n, q_nb_wxyz on a circle of 40 m at 5 m/s, nose forward, 30 m up."""
    a, w, r = 0.125 * t, 0.125, 40.0
    p = np.array([r * np.cos(a), r * np.sin(a), -30.0 - 3.0 * np.sin(0.3 * t)])
    v = np.array([-r * w * np.sin(a), r * w * np.cos(a), -0.9 * np.cos(0.3 * t)])
    return p, v, so3.from_euler(0.3, 0.02, a + np.pi / 2)


def write(path: Path, flight: Flight) -> None:
    """Write the log. Errors follow the scalar filter P' = P + q dt, K = P / (P + r), e' = (1 - K) e + K n of each component."""
    rng = np.random.default_rng(flight.seed)
    delay_ns = round(flight.delay_s * 1e9)
    variance = FIX_SIGMA**2
    error = rng.normal(size=9) * np.sqrt(variance)
    with Recorder(path) as recorder:

        def put(encoded: tuple[str, str, bytes], t_ns: int) -> None:
            recorder.write(*encoded, t_ns)

        last_fix_ns = EPOCH_NS
        for k in range(round(flight.duration_s * 1e9) // STEP_NS + 1):
            t, t_ns = k * STEP_NS * 1e-9, EPOCH_NS + k * STEP_NS
            if k:
                variance = variance + WALK**2 * STEP_NS * 1e-9
                error = error + WALK * np.sqrt(STEP_NS * 1e-9) * rng.normal(size=9)
            p, v, q = truth_at(t)
            hidden = any(a < t < b for a, b in flight.outages)
            if k % FIX_EVERY == 0 and not hidden:
                number = k // FIX_EVERY
                false = number % flight.false_every == flight.false_every - 1
                noise = rng.normal(size=9) * FIX_SIGMA
                innovation = error - noise
                sigma = np.sqrt(variance + FIX_SIGMA**2)
                if not false:
                    gain = variance / (variance + FIX_SIGMA**2)
                    error, variance = (1 - gain) * error + gain * noise, (1 - gain) * variance
                    last_fix_ns = t_ns
                fix_p = p + noise[:3] + (8.0 if false else 0.0)
                fix = PoseFix(t_ns, t_ns, vec3(fix_p), (q[0], q[1], q[2], q[3]), np.diag(np.repeat([0.0225, 4e-4], 3)))
                put(encode_input(fix), t_ns)
                if flight.aid_status:
                    put(encode(_status(fix, false, innovation, sigma, 0))[0], t_ns)
            put(encode(_estimate(t_ns, (p, v, q), error * flight.error_scale, variance, last_fix_ns))[0], t_ns + delay_ns)
            if k % 5 == 0:
                age = (t_ns - last_fix_ns) * 1e-9
                put(encode(_health(t_ns, age))[0], t_ns)
                for slow in encode_slow(_estimate(t_ns, (p, v, q), error * flight.error_scale, variance, last_fix_ns)):
                    put(slow, t_ns)
            if flight.truth and k % flight.truth_every == 0:
                put(encode_truth(t_ns, p, v, q), t_ns)
        put(
            encode(Reset(EPOCH_NS + 10**9, EPOCH_NS + 10**9, 1, (3.0, 4.0, 0.0), (0.0, 0.0, 2.0), (0.0, 0.0, np.pi / 180)))[0],
            t_ns,
        )


def rewritten(
    source: Path, out: Path, *, without: tuple[str, ...] = (), extra: tuple[tuple[str, str, bytes, int], ...] = ()
) -> Path:
    """The log without some topics and with other messages behind it."""
    with LogReader(source) as reader, Recorder(out) as recorder:
        for r in reader:
            if r.topic not in without:
                recorder.write(r.topic, r.schema, r.data, r.log_time_ns)
        for topic, schema, data, t_ns in extra:
            recorder.write(topic, schema, data, t_ns)
    return out


def write_vision(path: Path, sequence: Path) -> None:
    """A recorded flight of EuRoC: its visual poses as the estimate (0.1 m, 1 degree an axis), its truth as the truth."""
    with Recorder(path) as recorder:
        for name, topic, columns in (("truth.csv", "/truth", (1, 4, 7)), ("vision.csv", "/landfix/odometry", (1, None, 4))):
            for row in csv(sequence / name):
                t_ns = EPOCH_NS + round(row[0] * 1e9)
                recorder.write(topic, schemas.ODOMETRY, _odometry(t_ns, row, *columns), t_ns)


def csv(path: Path) -> Array:
    """Numbers of a CSV file, gzipped or not, below one header line."""
    gz = path.with_name(path.name + ".gz")
    with gzip.open(gz, "rt") if gz.exists() else path.open() as f:
        return np.loadtxt(f, delimiter=",", skiprows=1)


def _odometry(t_ns: int, row: Array, p: int, v: int | None, q: int) -> bytes:
    """A row of a recorded flight, whose world has z up and whose body is as it is, as an Odometry."""
    values = np.zeros(85)
    values[0:3], values[3:7] = row[p : p + 3], np.roll(row[q : q + 4], -1)
    values[43:46] = np.nan if v is None else Rotation.from_quat(values[3:7]).apply(row[v : v + 3], inverse=True)
    values[7:43] = np.diag(np.repeat([0.1**2, np.deg2rad(1.0) ** 2], 3)).ravel() if v is None else 0.0
    return cdr_fast.odometry(t_ns, values)


def _status(fix: PoseFix, false: bool, innovation: Array, sigma: Array, revision: int) -> AidStatus:
    given = [0, 1, 2, 6, 7, 8]
    return AidStatus(
        t_ns=fix.t_ns,
        arrived_ns=fix.arrived_ns,
        topic=fix.topic,
        kind="pose",
        reason=Reason.GATED if false else Reason.FUSED,
        revision=revision,
        innovation=tuple(innovation[given].tolist()),
        innovation_sigma=tuple(sigma[given].tolist()),
        test_ratio=30.0 if false else 0.4,
        delay_s=0.25,
    )


def _estimate(t_ns: int, truth: tuple[Array, Array, Array], error: Array, variance: Array, last_fix_ns: int) -> Estimate:
    """True = estimated (+) error, local in attitude."""
    p, v, q = truth
    nav, covariance = np.zeros(X.SIZE), np.eye(E.SIZE) * 1e-6
    nav[X.P], nav[X.V] = p - error[:3], v - error[3:6]
    nav[X.Q] = so3.multiply(q, so3.conjugate(so3.quat_exp(error[6:9])))
    covariance[:9, :9] = np.diag(variance)
    return Estimate(t_ns, t_ns, nav, covariance, (0.0, 0.0, 0.0), Mode.AIDED, 0, last_fix_ns, ORIGIN)


def _health(t_ns: int, age_s: float) -> Health:
    mode = Mode.AIDED if age_s < 2.0 else Mode.DEAD_RECKONING
    return Health(t_ns, t_ns, mode, age_s, 1.0, 1.0, 0, {"/pose_fix": "active"}, {"fused": 3}, 1)


def geodetic(p_n: Array) -> tuple[float, float, float]:
    """Latitude, longitude, height of a place on the map."""
    return Origin(*ORIGIN).to_geodetic(p_n)
