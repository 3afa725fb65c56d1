"""The whole way on real images: a log of IMU and pairs of EuRoC MH_01 whose fixes end, replayed with odometry and without."""

import gzip
from pathlib import Path

import numpy as np

from benchmarks.flights.tasks import data_folder
from benchmarks.odometry import sets
from calib.files.formats import save_rig
from estimator.config import Config, load
from estimator.frontend.files import load_odometry
from estimator.frontend.replay_odometry import OdometryReplay
from estimator.replay.replay import replay
from logs.evaluation.collected import read
from logs.store.recorder import Recorder
from logs.wire.codec import Encoded, encode_input
from logs.wire.images import encode_image
from models import so3
from models.camera import StereoRig
from models.messages import Array, ImuSample, PoseFix, vec3

FIXES_END_S, EPOCH_NS = 8.0, 1_700_000_000_000_000_000
R_BI = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # EuRoC's IMU: x up, z forward
R_NW = np.diag([1.0, -1.0, -1.0])
_FIX_SIGMA = (0.02, np.radians(0.5))


def run(folder: Path) -> list[tuple[str, ...]]:
    """Rows: seconds since the last fix; error and 1-sigma [m] without odometry, with it, and with 4 s of darkness."""
    folder.mkdir(parents=True, exist_ok=True)
    handheld = sets.euroc(sets.HANDHELD, 340)
    source, dark = _write(folder, handheld, "flight.mcap"), _write(folder, handheld, "dark.mcap", (12.0, 16.0))
    estimates = [_flown(source, enabled=False), _flown(source, enabled=True), _flown(dark, enabled=True)]
    rows = []
    for after_s in (2.0, 5.0, 9.0, 13.5):
        t_s = FIXES_END_S + after_s
        north, east, down = R_NW @ sets.pose_at(_table("truth"), t_s).p
        row = [f"{after_s:.1f}"]
        for t_ns, p, covariance in estimates:
            k = int(np.argmin(np.abs(t_ns - _ns(t_s))))
            row += [f"{np.linalg.norm(p[k] - (east, north, -down)):.2f}", f"{np.sqrt(np.trace(covariance[k][:3, :3])):.2f}"]
        rows.append(tuple(row))
    return rows


def _write(folder: Path, handheld: sets.Sequence, name: str, dark_s: tuple[float, float] = (0.0, 0.0)) -> Path:
    """A log of what a vehicle would record: IMU at 200 Hz, pairs at 10 Hz, pose fixes at 2 Hz until FIXES_END_S."""
    rig, rng = handheld.rig, np.random.default_rng(1)
    save_rig(folder / "rig.yaml", StereoRig(rig.left, rig.right, rig.R_rc, rig.t_rc, R_BI @ rig.R_bc, R_BI @ rig.p_bc))
    messages: list[tuple[int, Encoded]] = []
    for row in _table("imu"):
        if row[0] <= 22.0:
            t_ns = _ns(row[0])
            messages.append((t_ns, encode_input(ImuSample(t_ns, t_ns, vec3(R_BI @ row[1:4]), vec3(R_BI @ row[4:7])))))
    truth = _table("truth")
    for t_s in np.arange(truth[0, 0] + 0.5, FIXES_END_S + 0.01, 0.5).tolist():
        pose, t_ns = sets.pose_at(truth, t_s), _ns(t_s)
        error = rng.normal(0.0, np.repeat(_FIX_SIGMA, 3))
        q = so3.from_matrix(np.ascontiguousarray(so3.matrix(so3.quat_exp(error[3:])) @ R_NW @ pose.R @ R_BI.T))
        w, x, y, z = q.tolist()
        fix = PoseFix(t_ns, t_ns, vec3(R_NW @ pose.p + error[:3]), (w, x, y, z), np.diag(np.repeat(np.square(_FIX_SIGMA), 3)))
        messages.append((t_ns, encode_input(fix)))
    for frame in handheld.frames[::2]:
        t_ns, is_dark = _ns(frame.t_s), dark_s[0] <= frame.t_s < dark_s[1]
        for topic, image in zip(("/left/image", "/right/image"), frame.images(), strict=True):
            messages.append((t_ns + 5_000_000, encode_image(t_ns, np.zeros_like(image) if is_dark else image, topic)))
    with Recorder(folder / name) as recorder:
        for arrived_ns, message in sorted(messages, key=lambda item: item[0]):
            recorder.write(*message, arrived_ns)
    return folder / name


def _flown(source: Path, *, enabled: bool) -> tuple[Array, Array, Array]:
    """Times, positions and covariances of the estimate."""
    folder = source.parent
    file, out = folder / "flight.toml", folder / f"{source.stem}_{'with' if enabled else 'without'}.mcap"
    file.write_text(
        f'[rig]\nfile = "rig.yaml"\n[visual_odometry]\nenabled = {str(enabled).lower()}\ninterval_s = 0.2\n'
        '[inputs]\nleft_image = ["/left/image"]\nright_image = ["/right/image"]\n'
    )
    config = load(file)
    replay(source, out, config, processor=_again(config, folder, source) if enabled else None)
    estimate = read(out).estimate
    assert estimate.covariance is not None
    return np.asarray(estimate.t_ns), estimate.p, estimate.covariance


def _again(config: Config, folder: Path, source: Path) -> OdometryReplay:
    topics = config.inputs.left_image, config.inputs.right_image
    return OdometryReplay(load_odometry(folder / "rig.yaml"), config.visual_odometry, config.vision, topics, source)


def _table(name: str) -> Array:
    with gzip.open(data_folder() / "odometry" / sets.HANDHELD / f"{name}.csv.gz") as file:
        return np.loadtxt(file, delimiter=",", skiprows=1)


def _ns(t_s: float) -> int:
    return EPOCH_NS + round(t_s * 1e9)
