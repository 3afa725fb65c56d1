"""What a message costs, here and in other versions, in turns: by rate of fixes and of GNSS, history, number of IMUs.

    python -m benchmarks.speed.cost --trees this=. before=/path/to/worktree --rounds 7 --out out/bench/cost.json
    python -m benchmarks.speed.cost --trees rare=. this=. limits=. --rounds 7    a level in two minutes, in 2 s, limits

A row is a scene and a version: processor time in us, medians over the rounds, and the median of the ratios to the first version
in the same round. A worker of each version makes the same flight (level circles, 200 Hz); it imports only what old versions have.
"""

import argparse
import gc
import json
import math
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from estimator import fusion
from models.imu import ImuNoise
from models.messages import Array, GnssFix, GnssVelocity, ImuSample, Input, PoseFix, Vec3

SECONDS, BEGIN_NS, STEP_NS = 24.0, 1_700_000_000_000_000_000, 5_000_000
RADIUS_M, SPEED_M_S, GRAVITY = 5.0, 2.0, 9.80665
PLACE: Vec3 = (47.0, 8.0, 500.0)
NOISE = ImuNoise(7e-4, 4e-2, 1e-4, 1e-3)
STEADY_NS = 6_000_000_000  # from then on samples are quiet ones, but for the first three after a measurement
QUIET_AFTER, FEWEST = 3, 15


class Scene(msgspec.Struct, frozen=True):
    """Rates in Hz, 0: none; late_s: fixes arrive so long after their time of validity."""

    fixes_hz: float = 2.0
    gnss_hz: float = 0.0
    history_s: float = 6.0
    imus: int = 1
    late_s: float = 0.0


SCENES = {
    "fixes 2 Hz": Scene(),
    "fixes 2 Hz, 0.3 s late": Scene(late_s=0.3),
    "fixes 30 Hz, 5 s late": Scene(30.0, late_s=5.0),
    "fixes 10 Hz": Scene(10.0),
    "fixes 30 Hz": Scene(30.0),
    "fixes 2 Hz, GNSS 1 Hz": Scene(gnss_hz=1.0),
    "fixes 2 Hz, GNSS 5 Hz": Scene(gnss_hz=5.0),
    "fixes 2 Hz, GNSS 20 Hz": Scene(gnss_hz=20.0),
    "history 2 s": Scene(history_s=2.0),
    "history 30 s": Scene(history_s=30.0),
    "2 IMUs": Scene(imus=2),
    "3 IMUs": Scene(imus=3),
    "GNSS 5 Hz alone, aligning": Scene(0.0, 5.0),
}

LEVELS: dict[str, dict[str, Any]] = {"rare": {"time_to_alert_s": 60.0}, "limits": {"hal_m": 10.0, "val_m": 10.0}}


def messages(scene: Scene) -> list[Input]:
    """The flight in order of arrival; all but the fixes is punctual."""
    rng = np.random.default_rng(0)
    found: list[Input] = []
    for k in range(scene.imus):
        found += _imu(rng, "/imu" if k == 0 else f"/imu{k}", k * STEP_NS // 4)
    for t_ns in _stamps(scene.fixes_hz, STEP_NS // 3):
        p, yaw = _pose(t_ns)
        found.append(_fix(t_ns, p, yaw, round(scene.late_s * 1e9)))
    for t_ns in _stamps(scene.gnss_hz, STEP_NS // 2):
        p, yaw = _pose(t_ns)
        found.append(_gnss(t_ns, p + 0.5 * rng.standard_normal(3)))
        if scene.fixes_hz:
            v = SPEED_M_S * np.array([math.cos(yaw), math.sin(yaw), 0.0]) + 0.1 * rng.standard_normal(3)
            found.append(GnssVelocity(BEGIN_NS + t_ns, BEGIN_NS + t_ns, _vec3(v), 0.01 * np.eye(3)))
    return sorted(found, key=lambda m: m.arrived_ns)


def _stamps(rate_hz: float, after_ns: int) -> list[int]:
    """Between IMU samples, so that each splits a step."""
    count = round(SECONDS * rate_hz)
    return [round(k * 1e9 / rate_hz) // STEP_NS * STEP_NS + after_ns for k in range(count)]


def _pose(t_ns: int) -> tuple[Array, float]:
    angle = SPEED_M_S / RADIUS_M * t_ns * 1e-9
    return RADIUS_M * np.array([math.cos(angle), math.sin(angle), 0.0]), angle + math.pi / 2


def _vec3(x: Array) -> Vec3:
    return float(x[0]), float(x[1]), float(x[2])


def _imu(rng: np.random.Generator, topic: str, after_ns: int) -> list[ImuSample]:
    count, root = round(SECONDS * 1e9) // STEP_NS, math.sqrt(1e9 / STEP_NS)
    gyro = np.array([0.0, 0.0, SPEED_M_S / RADIUS_M]) + NOISE.gyro_noise * root * rng.standard_normal((count, 3))
    accel = np.array([0.0, SPEED_M_S**2 / RADIUS_M, -GRAVITY]) + NOISE.accel_noise * root * rng.standard_normal((count, 3))
    stamps = [BEGIN_NS + k * STEP_NS + after_ns for k in range(count)]
    return [ImuSample(t, t, _vec3(w), _vec3(f), topic) for t, w, f in zip(stamps, gyro, accel, strict=True)]


def _fix(t_ns: int, p: Array, yaw: float, late_ns: int) -> PoseFix:
    sigmas = np.array([0.15] * 3 + [math.radians(1.0)] * 3)
    off = sigmas * np.random.default_rng(t_ns).standard_normal(6)
    x, y, z = (0.5 * off[3:]).tolist()
    w, up = math.cos(yaw / 2), math.sin(yaw / 2)
    q = (w - up * z, w * x - up * y, w * y + up * x, up + w * z)
    length = math.hypot(*q)
    unit = (q[0] / length, q[1] / length, q[2] / length, q[3] / length)
    return PoseFix(BEGIN_NS + t_ns, BEGIN_NS + t_ns + late_ns, _vec3(p + off[:3]), unit, np.diag(sigmas**2))


def _gnss(t_ns: int, p: Array) -> GnssFix:
    lat = PLACE[0] + math.degrees(p[0] / 6.367e6)
    lon = PLACE[1] + math.degrees(p[1] / (6.388e6 * math.cos(math.radians(PLACE[0]))))
    return GnssFix(BEGIN_NS + t_ns, BEGIN_NS + t_ns, lat, lon, PLACE[2] - float(p[2]), 0.25 * np.eye(3))


def work(scene: Scene, levels: str) -> None:
    """At each line of stdin: us of a quiet IMU sample, and of everything per IMU sample of the first IMU."""
    options: dict[str, Any] = {"imu": NOISE, "estimator": fusion.EstimatorConfig(history_s=scene.history_s)}
    if scene.gnss_hz:
        options["origin"] = PLACE
    if scene.imus > 1:
        topics = ("/imu", *(f"/imu{k}" for k in range(1, scene.imus)))
        options |= {"imu_topics": topics, "imu_factors": (1.0,) * (scene.imus - 1)}
    if levels in LEVELS:
        from estimator.integrity.config import IntegrityConfig  # noqa: PLC0415 old versions have none

        options["integrity"] = IntegrityConfig(**LEVELS[levels])
    config = fusion.FusionConfig(**options)
    flight = messages(scene)
    _whole_us(config, flight)  # compiles
    print("ready", flush=True)
    for _ in sys.stdin:
        print(_quiet_us(config, flight), _whole_us(config, flight), flush=True)


def _whole_us(config: Any, flight: list[Input]) -> float:
    handle = fusion.Fusion(config).handle
    gc.collect()
    begin = time.process_time()
    for message in flight:
        handle(message)
    return (time.process_time() - begin) * 1e6 / (SECONDS * 1e9 / STEP_NS)


def _quiet_us(config: Any, flight: list[Input]) -> float:
    """Median over the stretches between measurements; nan where they are too short."""
    handle, found, stretch = fusion.Fusion(config).handle, list[float](), list[Input]()
    for message in flight:
        if isinstance(message, ImuSample):
            stretch.append(message)
            continue
        for sample in stretch[:QUIET_AFTER]:
            handle(sample)
        begin = time.process_time()
        for sample in stretch[QUIET_AFTER:]:
            handle(sample)
        if len(stretch) >= FEWEST and message.t_ns > BEGIN_NS + STEADY_NS:
            found.append((time.process_time() - begin) * 1e6 / len(stretch[QUIET_AFTER:]))
        stretch.clear()
        handle(message)
    return float(np.median(found)) if found else math.nan


def compare(name: str, trees: dict[str, Path], rounds: int) -> list[dict[str, Any]]:
    """The rows of a scene."""
    workers = {}
    for version, tree in trees.items():
        environment = os.environ | {"PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        command = [sys.executable, str(Path(__file__).resolve()), "--work", name, "--levels", version]
        pipe = subprocess.PIPE
        workers[version] = subprocess.Popen(command, cwd=tree, env=environment, stdin=pipe, stdout=pipe, text=True)
    ready = {version: _answer(worker) for version, worker in workers.items()}
    assert set(ready.values()) == {"ready"}, ready
    found: dict[str, list[Array]] = {version: [] for version in trees}
    for _ in range(rounds):
        for version, worker in workers.items():
            assert worker.stdin is not None
            worker.stdin.write("\n")
            worker.stdin.flush()
            found[version].append(np.array(_answer(worker).split(), float))
    for worker in workers.values():
        worker.communicate()
    first = np.array(found[next(iter(trees))])
    return [{"scene": name, "version": version, **_row(np.array(us), first)} for version, us in found.items()]


def _answer(worker: "subprocess.Popen[str]") -> str:
    assert worker.stdout is not None
    return worker.stdout.readline().strip()


def _row(us: Array, first: Array) -> dict[str, float | None]:
    columns = {
        "quiet_us": us[:, 0],
        "all_us": us[:, 1],
        "quiet_ratio": us[:, 0] / first[:, 0],
        "all_ratio": us[:, 1] / first[:, 1],
    }
    return {key: None if np.isnan(x).any() else round(float(np.median(x)), 3) for key, x in columns.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trees", nargs="+", default=["this=."], metavar="VERSION=FOLDER")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--out", type=Path, default=Path("out/bench/cost.json"))
    parser.add_argument("--work", choices=SCENES, help=argparse.SUPPRESS)
    parser.add_argument("--levels", default="", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.work:
        work(SCENES[args.work], args.levels)
        return
    trees = {version: Path(folder).resolve() for version, folder in (tree.split("=", 1) for tree in args.trees)}
    rows: list[dict[str, Any]] = []
    args.out.parent.mkdir(parents=True, exist_ok=True)
    for name in args.scenes:
        rows += compare(name, trees, args.rounds)
        lines = ",\n  ".join(json.dumps(row) for row in rows)
        args.out.write_text(f'{{"rounds": {args.rounds}, "unit": "us of processor time", "rows": [\n  {lines}\n]}}\n')
    print(args.out.read_text())


if __name__ == "__main__":
    main()
