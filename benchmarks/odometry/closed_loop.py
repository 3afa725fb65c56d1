"""Estimator and visual odometry as a closed loop: simulated IMU, rendered pairs, motion predicted by the estimates.

pairs of the true poses -> KeyFrames (motion predicted by the estimates) -> StereoOdometry -> OdometryDelta -> Fusion
"""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from msgspec.structs import replace

from estimator.config import parse
from estimator.frontend.key_frames import KeyFrames, VisualOdometryConfig
from estimator.frontend.odometry import delta_of, prediction_of
from estimator.frontend.requests import Pair, Shot, Track
from estimator.fusion import Fusion
from models.camera import StereoRig
from models.messages import AidStatus, Array, Estimate, ImuSample, Input
from models.sim.scenario import EPOCH_NS, Simulation, Truth
from models.state import E, X
from vision.image.rectify import Image
from vision.odometry.step import Frame, Prediction, Step, StereoOdometry
from vision.synthetic import Conditions, World, blur_of_motion, render_pair

Views = tuple[Image, Image]
STEP_S = 0.5
_LATE_NS = 60_000_000


class Times(NamedTuple):
    """Seconds of the flight: the first key frame, and when everything but the IMU and the cameras ends."""

    first_s: float
    outage_s: float


class Camera(Protocol):
    """Answers for the pairs of two times."""

    def step(self, t0_ns: int, t1_ns: int, prediction: Prediction) -> Step:
        """The motion between them."""
        ...


class Rendered:
    """Pairs of the true poses over a world, tracked with the rig as calibrated, taken with the true one."""

    def __init__(self, truth: Truth, world: World, calibrated: StereoRig, true: StereoRig) -> None:
        self._truth, self._world, self._rig = truth, world, true
        self._odometry = StereoOdometry(calibrated)
        self._frames: dict[int, Frame | str] = {}

    def step(self, t0_ns: int, t1_ns: int, prediction: Prediction) -> Step:
        """The motion between two times."""
        first, second = (self._frame(t_ns) for t_ns in (t0_ns, t1_ns))
        assert isinstance(first, Frame)
        assert isinstance(second, Frame)
        return self._odometry.step(first, second, prediction)

    def images(self, t_ns: int) -> Views:
        """The pair of a time."""
        k = int(np.searchsorted(self._truth.t_ns, t_ns))
        return self.rendered(k, self._truth.p_n[k])

    def rendered(self, k: int, p: Array) -> Views:
        """The pair at the attitude and speed of the truth's row k, from p."""
        truth, rig = self._truth, self._rig
        velocity_c = rig.R_bc.T @ truth.R_nb[k].T @ truth.v_n[k]
        blur = blur_of_motion(rig.left.fx, velocity_c, rig.R_bc.T @ truth.omega_b[k], max(-float(p[2]), 2.0), 0.003)
        return render_pair(self._world, rig, p, truth.R_nb[k], Conditions(blur_px=blur), np.random.default_rng(k))

    def _frame(self, t_ns: int) -> Frame | str:
        if t_ns not in self._frames:
            self._frames = dict(list(self._frames.items())[-1:])
            self._frames[t_ns] = self._odometry.frame(*self.images(t_ns))
        return self._frames[t_ns]


def flown(
    simulation: Simulation, camera: Camera | None, times: Times, *, height_given: bool
) -> tuple[list[Estimate], Counter[str]]:
    """Estimates, and how many increments ended how; camera: None: without odometry."""
    out_ns = EPOCH_NS + round(times.outage_s * 1e9)
    messages: list[Input] = [m for m in simulation.messages if isinstance(m, ImuSample) or m.t_ns < out_ns]
    fusion, track, reasons = Fusion(parse(simulation.config_toml).fusion()), Track(), Counter[str]()
    key_frames = KeyFrames(VisualOdometryConfig(interval_s=STEP_S, ground_m=0.0 if height_given else None))
    estimates: list[Estimate] = []
    next_ns = EPOCH_NS + round(times.first_s * 1e9)

    def handle(message: Input) -> None:
        outputs = fusion.handle(message)
        track.note(outputs)
        estimates.extend(o for o in outputs if isinstance(o, Estimate))
        reasons.update(str(o.reason) for o in outputs if isinstance(o, AidStatus) and o.topic.endswith("odometry_delta"))

    for message in messages:
        handle(message)
        if camera is None or message.arrived_ns < next_ns + _LATE_NS:
            continue
        shot = Shot("/left", "", b"", next_ns, next_ns, next_ns)
        asked = key_frames.request(Pair(shot, shot._replace(topic="/right")), track, message.arrived_ns)
        if asked is not None:
            step = camera.step(asked[0].t0_ns, next_ns, prediction_of(asked[0]))
            if step.reason:
                reasons["lost"] += 1
            else:
                handle(replace(delta_of(asked[0], step), arrived_ns=message.arrived_ns))
        next_ns += round(STEP_S * 1e9)
    return estimates, reasons


def error(simulation: Simulation, estimates: Sequence[Estimate], t_ns: int) -> tuple[Array, Array]:
    """Truth - estimate of the position (3,) at a time, and its covariance (3, 3)."""
    estimate = min(estimates, key=lambda e: abs(e.t_ns - t_ns))
    k = int(np.searchsorted(simulation.truth.t_ns, estimate.t_ns))
    return simulation.truth.p_n[k] - estimate.nav[X.P], estimate.covariance[E.P, E.P]
