"""Calibration on real recordings: published chessboard pairs, EuRoC's rig, IMUs at rest beside their data sheets; speed.

    python -m benchmarks.calibration.real

Needs the recorded data (LANDFIX_DATA). Writes out/bench_calibration/real.md.
"""

import gzip
import resource
import time
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.flights.tasks import data_folder
from benchmarks.tables import Table, number
from calib.board.chessboard import Board, View, find
from calib.cameras import mono, stereo
from calib.cameras.bundle import Seen, Solution, adjust
from calib.cameras.mono import Lens
from calib.cameras.stereo import Pair
from calib.errors import CalibrationError
from calib.files.formats import load_rig
from calib.inertial import imu
from models import so3
from models.messages import Array

OUT = Path("out/bench_calibration")
DATA_SHEETS = {  # rad/s/sqrt(Hz), m/s^2/sqrt(Hz)
    "euroc": ("ADIS16448, as published with the set", 1.7e-4, 2.0e-3),
    "tumvi_room": ("BMI160, data sheet BST-BMI160-DS000: 0.007 deg/s, 180 ug", 1.2e-4, 1.8e-3),
    "inertialnav_logs": ("Pixhawk: MPU-6000, data sheet PS-MPU-6000A-00: 0.005 deg/s, 400 ug", 8.7e-5, 3.9e-3),
    "ardupilot_logs": ("Pixhawk: MPU-6000, data sheet PS-MPU-6000A-00: 0.005 deg/s, 400 ug", 8.7e-5, 3.9e-3),
    "rtk_drive_walk": ("author's configuration; here the engine runs", 6.6e-5, 6.9e-4),
    "umn_thor75": ("not named; scatter on the ground / sqrt(50 Hz), its README", 4.2e-4, 2.8e-3),
    "quad_rtk_dot": ("Xsens DOT, from memory: 0.007 deg/s, 120 ug", 1.2e-4, 1.2e-3),
}


def views_of(folder: Path, pattern: str, board: Board) -> list[View]:
    """All views of a board in a folder's images."""
    found = [find(np.asarray(cv2.imread(str(p))), board, p.name) for p in sorted(folder.glob(pattern))]
    return [v for v in found if isinstance(v, View)]


def chessboards(folder: Path) -> list[Table]:
    """OpenCV's 13 pairs with every lens model, and what it costs."""
    board = Board()
    began = time.process_time()
    sides = [views_of(folder, f"{side}*.jpg", board) for side in ("left", "right")]
    found_s = time.process_time() - began
    rows, cost = [], []
    for lens in (Lens.TWO, Lens.FOUR, Lens.FIVE, Lens.EIGHT):
        began = time.process_time()
        left, right = (mono.calibrate(s, board, lens) for s in sides)
        both = stereo.calibrate([Pair(*p) for p in zip(*sides, strict=True)], board, lens)
        cost.append((lens.value, f"{time.process_time() - began:.1f} s"))
        rig = both.rig
        assert rig.covariance_rc is not None
        assert left.camera.covariance is not None
        sigma = np.sqrt(np.diagonal(rig.covariance_rc))
        turn = np.rad2deg(np.linalg.norm(so3.quat_log(so3.from_matrix(np.ascontiguousarray(rig.R_rc)))))
        rows.append((
            lens.value, f"{left.solution.rms:.3f}", f"{right.solution.rms:.3f}", f"{both.solution.rms:.3f}",
            f"{left.held_out.rms:.3f}", f"{both.epipolar_before_px:.2f}",
            f"{both.epipolar_after_px:.3f}", f"{both.held_out.rms:.3f}",
            f"{left.camera.fx:.2f} +- {np.sqrt(left.camera.covariance[0, 0]):.2f}", f"{left.spread.max():.1f}",
            f"{1e3 * rig.baseline_m:.2f} +- {1e3 * sigma[0]:.2f}", f"{turn:.2f} +- {np.rad2deg(sigma[3:].max()):.2f}",
            f"{1e3 * both.square_m:.3f}",
        ))  # fmt: skip
    rows.append((
        "reference", "0.195", "0.207", "0.217", "", "", "0.171", "0.173-0.176", "532.83", "", "83.21", "0.50", "25.011",
    ))  # fmt: skip
    columns = (
        "lens", "left px", "right px", "stereo px", "left out px", "epipolar px", "rectified px", "left out px", "fx left",
        "worst change / sigma", "baseline mm", "rotation deg", "square mm",
    )  # fmt: skip
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    speed = [
        ("26 VGA images: corners", f"{found_s:.2f} s"),
        *(("two cameras and the rig, lens " + lens, t) for lens, t in cost),
    ]
    speed.append(("peak memory of the process", f"{memory:.0f} MB"))
    return [Table("OpenCV's 13 chessboard pairs", columns, rows), Table("Cost", ("what", "time"), speed)]


def stability(folder: Path) -> Table:
    """Is sigma what leaving views out says? Scatter of calibrations without one view, difference of two without common views."""
    board, rows = Board(), []
    for side in ("left", "right"):
        whole = mono.calibrate(views_of(folder, f"{side}*.jpg", board), board).solution
        problem, n = whole.problem, len(whole.problem.views)
        without = np.array([pinhole(adjust(problem.only([i for i in range(n) if i != k]))) for k in range(n)])
        jackknife = np.sqrt((n - 1) / n * np.sum((without - without.mean(axis=0)) ** 2, axis=0))
        odd, even = (adjust(problem.only(range(first, n, 2))) for first in (0, 1))
        apart = np.abs(pinhole(odd) - pinhole(even)) / np.hypot(pinhole_sigma(odd), pinhole_sigma(even))
        for name, x, sigma, moved, z in zip(
            ("fx", "fy", "cx", "cy"), pinhole(whole), pinhole_sigma(whole), jackknife, apart, strict=True
        ):
            rows.append((f"{side} {name}", f"{x:.2f}", f"{sigma:.2f}", f"{moved:.2f}", f"{z:.1f}"))
    columns = ("parameter px", "all views", "sigma", "jackknife over views", "odd - even views / sigma")
    return Table("Is sigma consistent on the published images?", columns, rows)


def pinhole(solution: Solution) -> Array:
    """fx fy cx cy of the first camera [px]."""
    camera = solution.problem.cameras[0]
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy])


def pinhole_sigma(solution: Solution) -> Array:
    """Their standard deviations [px]."""
    return np.asarray(np.sqrt(np.diagonal(solution.covariance)[:4]))


def published(folder: Path) -> Table:
    """Where OpenCV's published left camera comes from: windows of 11 px, which in left02 hold several squares."""
    board, names = Board(), sorted(folder.glob("left*.jpg"))
    images = [np.asarray(cv2.imread(str(p), cv2.IMREAD_GRAYSCALE)) for p in names]
    views = []
    for name, image in zip(names, images, strict=True):
        rough = np.asarray(cv2.findChessboardCorners(image, (9, 6))[1], np.float32).reshape(-1, 1, 2)
        px = cv2.cornerSubPix(image, rough, (11, 11), (-1, -1), (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.1))
        views.append(View(name.name, 640, 480, np.arange(54), px.reshape(-1, 2).astype(np.float64), 0.0))
    own = views_of(folder, "left*.jpg", board)
    calibrated = [
        ("those corners, all 13 views", adjust(mono.start(views, board, Lens.FIVE))),
        ("those corners, left02 dropped as an outlier", mono.calibrate(views, board).solution),
        ("our corners", mono.calibrate(own, board).solution),
    ]
    rows: list[tuple[str, ...]] = [("published", "0.393", "535.92", "342.28", "235.57", "1.18")]
    for what, s in calibrated:
        numbers = [f"{x:.2f} +- {d:.2f}" for x, d in zip(pinhole(s)[[0, 2, 3]], pinhole_sigma(s)[[0, 2, 3]], strict=True)]
        rows.append((what, f"{s.rms:.3f}", *numbers, f"{max(s.view_rms()):.2f}"))
    return Table("OpenCV's published left camera", ("corners", "residual px", "fx", "cx", "cy", "worst view px"), rows)


def euroc(folder: Path, calibration: Path) -> Table:
    """EuRoC's published rig, through our Kalibr import, on its own images of a 7 x 6 board of 60 mm."""
    rig, board = load_rig(calibration), Board(7, 6, 0.06)
    left, right = views_of(folder / "cam0", "*", board), views_of(folder / "cam1", "*", board)
    pairs = [p for a, b in zip(left, right, strict=True) if (p := stereo.shared(Pair(a, b), board)) is not None]
    errors = np.concatenate(stereo.row_errors(rig, pairs))
    sides = stereo.square_sides(rig, pairs, board)
    turn = np.rad2deg(np.linalg.norm(so3.quat_log(so3.from_matrix(np.ascontiguousarray(rig.R_rc)))))
    depth = [mono.board_pose(rig.left, Seen(board.points[v.ids], v.px)).of(board.points.mean(axis=0)[None])[0, 2] for v in left]
    return Table("EuRoC's published rig on its board (8 pairs, at rest)", ("what", "here", "reference"), [
        ("pairs with the board", str(len(pairs)), "8"),
        ("baseline m", f"{rig.baseline_m:.5f}", "0.11008"),
        ("rotation deg", f"{turn:.3f}", "0.818"),
        ("rectified row error px, RMS", f"{np.sqrt(np.mean(errors**2)):.3f}", "0.323 (SIFT)"),
        ("triangulated square mm", f"{1e3 * sides.mean():.2f}", "60.2"),
        ("distance of the board m", f"{np.mean(depth):.3f}", "2.27"),
    ])  # fmt: skip


def read_imu(path: Path) -> tuple[NDArray[np.int64], Array, Array]:
    """t_s, gyro, accel of an imu.csv.gz."""
    with gzip.open(path, "rt") as file:
        rows = np.genfromtxt(file, delimiter=",", skip_header=1)
    if rows[0, 0] > 1e12:
        rows[:, 0] = (rows[:, 0] - rows[0, 0]) * 1e-9
    rows = rows[np.concatenate(([True], np.diff(rows[:, 0]) > 0))]
    return np.rint(1e9 * rows[:, 0]).astype(np.int64), rows[:, 1:4], rows[:, 4:7]


def at_rest(flights: Path) -> Table:
    """Allan deviation of the longest rest of every IMU; where there is none, the scatter of the quietest half second."""
    rows = []
    for path in sorted(flights.glob("**/imu*.csv.gz")):
        name = path.relative_to(flights).as_posix().removesuffix(".csv.gz").removesuffix("/imu")
        sheet = (
            DATA_SHEETS[name.partition("/")[0]] if "/imu2" not in name else ("Pixhawk's second IMU, not named", np.nan, np.nan)
        )
        recording, seen = read_imu(path), tuple[str, ...]()
        try:
            found = imu.static_noise(*recording)
        except CalibrationError:
            gyro, accel = quietest(*recording)
            seen = (
                "0.5",
                f"{1e9 / np.median(np.diff(recording[0])):.0f}",
                "",
                "",
                f"{number(gyro)} (scatter)",
                f"{number(accel)} (scatter)",
            )
        else:
            g, a = imu.worst(found.gyro), imu.worst(found.accel)
            white = "never" if np.isnan(found.white_from_s) else f"{found.white_from_s:.2f}"
            seen = (
                f"{found.duration_s:.1f}", f"{found.rate_hz:.0f}", white, f"{found.longest_tau_s:.2f}",
                *(f"{number(n.density)} +- {100.0 * n.density_sigma / n.density:.0f} %" for n in (g, a)),
            )  # fmt: skip
        rows.append((name, *seen[:5], number(sheet[1]), seen[5], number(sheet[2]), sheet[0]))
    columns = ("IMU", "rest s", "Hz", "white from s", "known to s", "gyro", "data sheet", "accel", "data sheet", "which")
    return Table("Noise density at rest (rad/s/sqrt(Hz), m/s^2/sqrt(Hz)), worst axis", columns, rows)


def quietest(t_ns: NDArray[np.int64], gyro: Array, accel: Array) -> tuple[float, float]:
    """Scatter of the quietest half second over the root of the rate: the density, were it white."""
    rate = 1e9 / float(np.median(np.diff(t_ns)))
    n = int(0.5 * rate)
    k = len(t_ns) // n
    scatter = [x[: k * n].reshape(k, n, 3).std(axis=1).max(axis=1) / np.sqrt(rate) for x in (gyro, accel)]
    best = int(np.argmin(scatter[0] / np.median(scatter[0]) + scatter[1] / np.median(scatter[1])))
    return float(scatter[0][best]), float(scatter[1][best])


def main() -> None:
    """All tables."""
    cv2.setNumThreads(1)
    OUT.mkdir(parents=True, exist_ok=True)
    data = data_folder()
    images, flights = data / "images", data / "flights"
    tables = [
        *chessboards(images / "opencv_chessboard_stereo"),
        stability(images / "opencv_chessboard_stereo"),
        published(images / "opencv_chessboard_stereo"),
        euroc(images / "euroc_v101_static_stereo_imu", flights / "euroc" / "calib.json"),
        at_rest(flights),
    ]  # fmt: skip
    text = "\n".join(t.markdown() for t in tables)
    (OUT / "real.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
