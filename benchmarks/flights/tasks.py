"""Estimation tasks made of recorded flights, and their scores.

Making and scoring is the work of `tools/flight_task.py` next to the data, loaded as it stands, so that every estimator is
judged by one and the same program. Tasks are kept: the same flight, scenario, seed and tool give the same file.
"""

import contextlib
import functools
import hashlib
import importlib.util
import io
import json
import os
from argparse import Namespace
from pathlib import Path
from types import ModuleType
from typing import Any

import msgspec
import numpy as np
from mcap.reader import make_reader
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from logs.evaluation.metrics import nees
from logs.evaluation.trajectory import decode, nearest
from models.messages import Array

ROOT = Path(__file__).resolve().parents[2]
SETS = {"euroc": "euroc", "tumvi": "tumvi_room", "quad": "quad_rtk_dot"}  # short name -> folder; all have attitude truth
VISION = {"V": "N", "W": "A"}  # scenarios of real vision estimates as fixes -> the scenario whose outages they have
VISION_NEAR_NS, VISION_BURN_NS = 100_000_000, 10_000_000_000
VISION_SIGMA_M, VISION_SIGMA_RAD = 0.1, np.deg2rad(1.5)  # configured
FIX_TYPE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TYPES = {"/imu": "sensor_msgs/msg/Imu", "/truth": "nav_msgs/msg/Odometry"}
MATCH_NS = 6_000_000  # an estimate belongs to a truth stamp if it is that near, as for the scoring tool
INSIDE95 = 7.815  # chi-square, 3 degrees of freedom, 95 %


def data_folder() -> Path:
    """Where the recorded flights are: LANDFIX_DATA, or ../shared/data next to the repository."""
    return Path(os.environ.get("LANDFIX_DATA", ROOT.parent / "shared" / "data")).resolve()


@functools.cache
def tool() -> ModuleType:
    """flight_task.py as a module; it reads an MCAP once for however many questions."""
    path = data_folder().parent / "tools" / "flight_task.py"
    spec = importlib.util.spec_from_file_location("flight_task", path)
    if not path.exists() or spec is None or spec.loader is None:
        raise SystemExit(f"{path} not found: set LANDFIX_DATA to the folder of recorded flights")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Task(msgspec.Struct, frozen=True):
    """One flight in one scenario with one seed."""

    group: str
    flight: str
    scenario: str
    seed: int

    @property
    def name(self) -> str:
        """As a person reads it, and as the file is called."""
        return f"{self.group}-{self.flight}-{self.scenario}-{self.seed}"

    @property
    def folder(self) -> Path:
        """Where the flight lies."""
        return data_folder() / "flights" / SETS[self.group] / self.flight


def flights(group: str) -> list[str]:
    """Names of the flights of a set that are there."""
    return sorted(p.name for p in (data_folder() / "flights" / SETS[group]).glob("*/") if p.is_dir())


def tasks(groups: list[str], scenarios: str, seeds: list[int], every: int = 1) -> list[Task]:
    """All combinations; of each set every n-th flight. Vision estimates exist for euroc only, and have no seeds."""
    return [
        Task(group, flight, scenario, seed)
        for scenario in scenarios
        for group in groups
        for flight in flights(group)[::every]
        for seed in seeds
        if scenario not in VISION or (group == "euroc" and seed == seeds[0])
    ]


def make(task: Task, folder: Path) -> Path | None:
    """The task's MCAP (its .toml and .json next to it), None if the flight is too short for the scenario."""
    source = Path(tool().__file__ or "").read_bytes()
    folder = folder / hashlib.sha256(source).hexdigest()[:8]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{task.name}.mcap"
    if task.scenario in VISION:
        base = make(msgspec.structs.replace(task, scenario=VISION[task.scenario]), folder.parent)
        if base is not None:
            _exchange_fixes(base, path, task)
        return path if base is not None else None
    if not path.with_suffix(".toml").exists():  # written last
        request = Namespace(flight=str(task.folder), scenario=task.scenario, seed=task.seed, out=str(path), toml=None)
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                tool().make(request)
        except SystemExit:  # the tool says "too short"
            return None
    return path


def _exchange_fixes(base: Path, out: Path, task: Task) -> None:
    """Write `base` again with EuRoC's real vision estimates, the first at or after each of its fixes, in their place.

    Where vision starts late, the truth before that and in the 10 s after it is left out, and with it its score.
    """
    t = tool()
    with base.open("rb") as f:
        messages = [(m.log_time, c.topic, m.data) for _, c, m in make_reader(f).iter_messages(log_time_order=False)]
    stamps_ns, vision = vision_poses(task)
    wanted = np.array([log_time for log_time, topic, _ in messages if topic == "/pose_fix"])
    row = np.minimum(np.searchsorted(stamps_ns, wanted), len(stamps_ns) - 1)  # never one from inside an outage
    row = np.unique(row[np.abs(stamps_ns[row] - wanted) < VISION_NEAR_NS])
    begin = int(stamps_ns[row[0]]) + VISION_BURN_NS
    kept = [m for m in messages if m[1] == "/imu" or (m[1] == "/truth" and m[0] >= begin)]
    events = [(log_time, 1, topic, t.STORE.deserialize_cdr(data, TYPES[topic])) for log_time, topic, data in kept]
    covariance = np.diag([VISION_SIGMA_M**2] * 3 + [VISION_SIGMA_RAD**2] * 3).ravel()
    for k in row:
        pose = t.T["geometry_msgs/msg/PoseWithCovariance"](pose=vision[k], covariance=covariance)
        header = t.header((stamps_ns[k] - t.EPOCH_NS) * 1e-9, "map")
        events.append((int(stamps_ns[k]), 0, "/pose_fix", t.T[FIX_TYPE](header=header, pose=pose)))
    writer = t.McapOut(out)
    for log_time, _, topic, message in sorted(events, key=lambda e: e[:2]):
        writer.write(topic, TYPES.get(topic, FIX_TYPE), message, log_time)
    writer.close()
    meta = json.loads(base.with_suffix(".json").read_text())
    out.with_suffix(".json").write_text(json.dumps({**meta, "scenario": task.scenario}))
    out.with_suffix(".toml").write_text(base.with_suffix(".toml").read_text())


def vision_poses(task: Task) -> tuple[NDArray[np.int64], list[Any]]:
    """Stamps, on the task's clock, and poses (ENU, FLU) of the flight's vision.csv."""
    t = tool()
    imu, truth, vision = (t.load(task.folder / name) for name in ("imu.csv", "truth.csv", "vision.csv"))
    start_s = max(imu[0, 0], truth[np.isfinite(truth[:, 1:11]).all(axis=1)][0, 0])  # where the tool starts its clock
    b, w = t.AXES["euroc"]
    attitudes = w @ Rotation.from_quat(vision[:, 4:8], scalar_first=True).as_matrix() @ b.T
    stamps_ns = t.EPOCH_NS + np.round((vision[:, 0] - start_s) * 1e9).astype(np.int64)
    return stamps_ns, [t.pose(w @ p, Rotation.from_matrix(r)) for p, r in zip(vision[:, 1:4], attitudes, strict=True)]


def score(task_file: Path, estimate: Path) -> dict[str, Any]:
    """What the tool says of an estimate, and under "pool" the sums from which consistency is pooled over runs."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
        tool().score(Namespace(task=str(task_file), estimate=str(estimate), json=True))
    if not said.getvalue():
        return {"complete": False}
    result: dict[str, Any] = json.loads(said.getvalue())
    return {**result, **_pool(task_file, estimate, result)}


def _pool(task_file: Path, estimate: Path, meta: dict[str, Any]) -> dict[str, Any]:
    """Counts and sums at the scored truth stamps, and the largest error outside outages (and the time after them)."""
    truth, found = read_odometry(task_file, "/truth"), read_odometry(estimate, "/landfix/odometry")
    row, near = nearest(found.t_ns, truth.t_ns, MATCH_NS)
    seconds = (truth.t_ns - tool().EPOCH_NS) * 1e-9
    keep = near & (seconds >= tool().BURN_S.get(meta["scenario"], 10.0))
    truth, found, seconds = truth[keep], found[row[keep]], seconds[keep]
    error = truth.p - found.p
    ratio = nees(error, found.covariance[:, :3, :3]) / 3.0
    settle = tool().SETTLE_S.get(meta["scenario"], 2.0)
    inside, near_outage = np.zeros(len(seconds), bool), np.zeros(len(seconds), bool)
    for a, b in meta["outages"]:
        inside |= (seconds > a) & (seconds < b)
        near_outage |= (seconds > a) & (seconds < b + settle)
    size = np.linalg.norm(error, axis=1)
    return {
        "max_m": float(size[~near_outage].max(initial=0.0)),
        "pool": {"outside": _sums(ratio[~inside]), "inside": _sums(ratio[inside])},
    }


def _sums(ratio: Array) -> dict[str, float]:
    return {"n": len(ratio), "nees": float(ratio.sum()), "covered": int((3.0 * ratio < INSIDE95).sum())}


def read_odometry(path: Path, topic: str) -> Any:
    with path.open("rb") as f:
        rows = [(m.data, m.log_time) for _, _, m in make_reader(f).iter_messages(topics=[topic])]
    data, arrived = zip(*rows, strict=True)
    return decode("nav_msgs/msg/Odometry", data, arrived)
