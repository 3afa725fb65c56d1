"""Run everything once before the flight."""

import numpy as np

from estimator.fusion import Fusion, FusionConfig
from estimator.publish import OutputConfig, Publisher
from logs.wire.codec import Decoder, encode_input
from models.measurements import DIRECTION_SCALE
from models.messages import GnssFix, GnssVelocity, ImuSample, Input, LandmarkFix, PoseFix, Tick

_STEP_NS = 5_000_000
_PLACE = (47.0, 8.0, 400.0)
_LEVEL = (1.0, 0.0, 0.0, 0.0)
_FALSE_M = 50.0
_NOT_GIVEN: tuple[list[int], ...] = ([], [3, 4], [5])  # of x y z rx ry rz: nothing; roll and pitch; yaw


def warm_up() -> None:
    """Two seconds of flight with late, partial, false fixes and a gap."""
    decoder, fusion, publisher = Decoder(), Fusion(FusionConfig(origin=_PLACE)), Publisher(OutputConfig())
    for message in _flight():
        topic, schema, data = encode_input(message)
        read = decoder.decode(topic, schema, data, message.arrived_ns)
        assert read is not None
        list(publisher.encoded(fusion.handle(read)))


def _flight() -> list[Input]:
    messages: list[Input] = []
    for k in range(400):
        t_ns = (k + 1) * _STEP_NS
        messages.append(ImuSample(t_ns, t_ns, (0.0, 0.0, 1e-3 * (k % 7)), (1e-2 * (k % 5), 0.0, -9.81)))
        if k % 20 == 0:
            validity_ns = max(_STEP_NS, t_ns - 10 * _STEP_NS)
            north_m = _FALSE_M if k > 300 else 0.0
            messages.append(_pose_fix(validity_ns, t_ns, north_m, _NOT_GIVEN[k // 20 % len(_NOT_GIVEN)]))
            messages.append(_landmark_fix(validity_ns, t_ns, in_part=k % 40 == 0))
        if k % 20 == 10:  # between two fixes: what a false one leaves undecided is published
            messages.append(GnssFix(t_ns, t_ns, *_PLACE, np.eye(3)))
            messages.append(GnssVelocity(t_ns, t_ns, (0.0, 0.0, 0.0), np.eye(3)))
    end_ns = messages[-1].t_ns + 300_000_000
    return [*messages, Tick(end_ns, end_ns)]


def _pose_fix(validity_ns: int, arrived_ns: int, north_m: float, not_given: list[int]) -> PoseFix:
    covariance = np.eye(6) * 1e-2
    covariance[not_given, not_given] = np.nan
    return PoseFix(validity_ns, arrived_ns, (north_m, 0.0, 0.0), _LEVEL, covariance)


def _landmark_fix(validity_ns: int, arrived_ns: int, *, in_part: bool) -> LandmarkFix:
    cov, moved = np.eye(6) * 1e-2, np.eye(6)[:, :3] * 0.1
    directions = np.eye(6)[:5] * DIRECTION_SCALE if in_part else None
    return LandmarkFix(
        validity_ns, arrived_ns, (0.0, 0.0, 0.0), _LEVEL, cov, moved @ moved.T + cov, ("roof",), 0.9, 0.5, moved[None], cov,
        directions, None if directions is None else np.zeros(5),
    )  # fmt: skip
