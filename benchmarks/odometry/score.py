"""Odometry along a sequence, and how far it drifts."""

import time
from typing import NamedTuple

import numpy as np

from benchmarks.odometry.sets import Pose, Sequence
from models import so3
from models.messages import Array
from vision.odometry.step import Prediction, Step, StereoOdometry

_SPEED_SIGMA, _TURN_SIGMA = 0.1, np.radians(0.1)  # of the prediction: m/s, and rad a step; drawn


class Scored(NamedTuple):
    """Steps in order; errors (N, 6) of those not lost; path: chained poses; lost steps are the truth's, and add no error."""

    name: str
    steps: list[Step]
    errors: Array
    lengths: Array
    nees: Array  # (N, 2): of position and rotation, over 3
    path: list[Pose]
    truth: list[Pose]
    lengths_m: tuple[float, ...]
    frame_ms: list[float]
    step_ms: list[float]
    reasons: list[str]

    @property
    def lost(self) -> int:
        """Steps without an answer."""
        return len(self.reasons)

    def drift(self) -> tuple[float, float, float]:
        """Translation in %, rotation in deg/m over all sub-paths of lengths_m, and the error of the end in % (as KITTI's)."""
        along = np.r_[0.0, np.cumsum([np.linalg.norm(b.p - a.p) for a, b in zip(self.truth, self.truth[1:], strict=False)])]
        rows = []
        for length in self.lengths_m:
            for i in range(len(along)):
                j = int(np.searchsorted(along, along[i] + length))
                if j < len(along):
                    e, turn = _difference(relative(self.truth[i], self.truth[j]), relative(self.path[i], self.path[j]))
                    way = along[j] - along[i]
                    rows.append((100.0 * np.linalg.norm(e) / way, np.degrees(np.linalg.norm(turn)) / way))
        mean = np.mean(rows, axis=0).tolist() if rows else [np.nan, np.nan]
        e, _ = _difference(relative(self.truth[0], self.truth[-1]), relative(self.path[0], self.path[-1]))
        return mean[0], mean[1], float(100.0 * np.linalg.norm(e) / along[-1])


def relative(a: Pose, b: Pose) -> Pose:
    """b in the axes of a."""
    return Pose(a.R.T @ (b.p - a.p), a.R.T @ b.R)


def run(
    sequence: Sequence,
    longest_s: float = 10.0,
) -> Scored:
    """All steps of a sequence; longest_s: of a step."""
    odometry = StereoOdometry(sequence.rig)
    rng = np.random.default_rng(11)
    truth = [f.pose for f in sequence.frames]
    path, errors, lengths, nees, steps, reasons = [truth[0]], [], [], [], [], []
    frame_ms: list[float] = []
    step_ms: list[float] = []
    previous = None
    for k, frame in enumerate(sequence.frames):
        current = None
        if sequence.tracks is None:
            left, right = frame.images()
            started = time.process_time()
            current = odometry.frame(left, right)
            frame_ms.append(1e3 * (time.process_time() - started))
        if k > 0:
            dt = frame.t_s - sequence.frames[k - 1].t_s
            true = relative(truth[k - 1], truth[k])
            prediction = _prediction(true, dt, rng)
            started = time.process_time()
            if dt > longest_s:
                path.append(_chained(path[-1], true))
                previous = current
                continue
            if sequence.tracks is not None:
                step = odometry.motion_of(sequence.tracks(sequence.frames[k - 1].number, frame.number), prediction)
            elif isinstance(current, str) or isinstance(previous, str):
                step = Step(current if isinstance(current, str) else "no pair before")
            else:
                assert previous is not None
                assert current is not None
                step = odometry.step(previous, current, prediction)
            step_ms.append(1e3 * (time.process_time() - started))
            steps.append(step)
            if step.reason:
                reasons.append(step.reason)
                path.append(_chained(path[-1], true))
            else:
                e, turn = _difference(true, Pose(step.p, so3.matrix(step.q)))
                errors.append(np.r_[e, turn])
                lengths.append(np.linalg.norm(true.p))
                total = step.covariance + step.systematic @ step.systematic.T
                constant, share = sequence.truth_sigma
                total[:3, :3] += (constant**2 + (share * lengths[-1]) ** 2) * np.eye(3)
                nees.append([x @ np.linalg.solve(total[s, s], x) / 3 for x, s in ((e, slice(0, 3)), (turn, slice(3, 6)))])
                path.append(_chained(path[-1], Pose(step.p, so3.matrix(step.q))))
        previous = current
    return Scored(
        sequence.name, steps, np.array(errors).reshape(-1, 6), np.array(lengths), np.array(nees).reshape(-1, 2), path, truth,
        sequence.lengths_m, frame_ms, step_ms, reasons,
    )  # fmt: skip


def _prediction(true: Pose, dt: float, rng: np.random.Generator) -> Prediction:
    """The truth with drawn errors, as a filter with a gyro and a known velocity has them."""
    covariance = np.diag(np.square([_SPEED_SIGMA * dt] * 3 + [_TURN_SIGMA] * 3))
    e = rng.multivariate_normal(np.zeros(6), covariance)
    q = so3.multiply(so3.from_matrix(np.ascontiguousarray(true.R)), so3.quat_exp(e[3:]))
    return Prediction(np.asarray(true.p + e[:3]), q, covariance)


def _chained(a: Pose, step: Pose) -> Pose:
    return Pose(a.p + a.R @ step.p, a.R @ step.R)


def _difference(true: Pose, estimated: Pose) -> tuple[Array, Array]:
    return estimated.p - true.p, so3.quat_log(so3.from_matrix(np.ascontiguousarray(true.R.T @ estimated.R)))
