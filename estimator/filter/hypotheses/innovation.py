"""A measurement seen from one filter, with the systematic errors that it carries."""

from estimator.filter.eskf import Eskf, Innovation
from estimator.sources.air.through_air import AirVelocity, DragForce, is_scale
from estimator.sources.air.wind import WIND
from estimator.sources.base.aid import Aid
from models.measurements import Measurement
from models.messages import Array
from models.relative_pose import RelativePose

MOST_OF_A_KIND = 8  # slow errors of landmarks at a time


def clone_of(topic: str) -> str:
    """Block of the pose kept for an odometry."""
    return f"{topic}.kept"


def innovation(eskf: Eskf, aid: Aid, z: Measurement, gyro_b: Array) -> Innovation:
    """The measurement seen from one filter, with its slow errors."""
    carried = [(slow.block, slow.moves(eskf.x)) for slow in aid.slow_errors]
    if isinstance(z, RelativePose):
        kept = clone_of(aid.topic)
        z = z.since(eskf.clones[kept])
        carried.append((kept, z.by_origin(eskf.x)))
    eskf.slow = eskf.slow.used([block for block, _ in carried])  # first: none of them makes room for another one of them
    for slow, block in zip(aid.slow_errors, carried, strict=False):  # a kept pose, behind them, is there
        if (known := eskf.slow.columns.get(slow.block)) is not None:
            if known.stop - known.start == len(slow.covariance):
                continue
            eskf.forget(slow.block)  # of another size than before: another error
        if oldest := eskf.slow.oldest(slow.block.rpartition("/")[0], MOST_OF_A_KIND):
            eskf.forget(oldest)
        eskf.consider(slow.block, slow.covariance, slow.tau_s, slow.walk)
        if slow.walk is not None and not slow.starts_at_zero:
            eskf.zero(slow.block, eskf.innovation(z, gyro_b, [block]))
    if isinstance(z, AirVelocity | DragForce):
        z = z.in_wind(eskf.slow.of(WIND))
        carried = [(block, z.by_scale(eskf.x) if is_scale(block) else jacobian) for block, jacobian in carried]
    return eskf.innovation(z, gyro_b, carried)
