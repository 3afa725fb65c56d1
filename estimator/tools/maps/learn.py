"""A map learned by flying: images of a log at smoothed poses become landmarks with covariances."""

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import msgspec
import numpy as np

from estimator.config import Config
from estimator.filter.smoother import Smoothed, smooth
from estimator.frontend.requests import Pair, Pairing, Shot, prior_at
from logs.store.reader import LogReader
from logs.wire.images import ImageError, decode_image
from logs.wire.stamps import stamp_of
from models.camera import StereoRig
from models.frames import Origin
from models.maps.landmarks import LandmarkMap
from models.messages import Estimate, GnssFix, Input, LandmarkFix, Mode, vec3
from models.prior import Prior
from vision.describe.measure import Measured
from vision.describe.regions import Limits, Region
from vision.describe.survey import Settings, Survey, survey
from vision.image.rectify import Rectification, rectification
from vision.learn.mapping import Mapper, MappingConfig, Observation, observe
from vision.learn.tracks import KeepConfig, learned

_OLDEST_NS = 200_000_000  # a pose further from the exposure is not used for it
_STANDING_S = 2.0  # of the log's beginning, when the vehicle stands on the ground
_LOWEST_M = 10.0  # above ground: below it little is seen, and what stands on four wheels is large
_DARK = 0.35  # of the image's median: shadows, which move with the sun
_READ, _SMOOTHED = 0.1, 0.4  # of the work


class LearnError(ValueError):
    """A log from which nothing can be learned; one line."""


class LearnConfig(msgspec.Struct, frozen=True):
    """most_hz: pairs; most_sigma_m: of a pose, horizontally; ground_alt_m: None: of the start; colours_bgr: none: any."""

    most_hz: float = 2.0
    most_sigma_m: float = 1.5
    ground_alt_m: float | None = None
    colours_bgr: tuple[tuple[int, int, int], ...] = ()
    least_px: int = 60
    mapping: MappingConfig = MappingConfig()
    keep: KeepConfig = KeepConfig()


class LearnSummary(msgspec.Struct, frozen=True):
    """images: processed; skipped, left_out: by reason; seen: images per landmark; common_sigma_m: horizontal, vertical, of the
    whole map.
    """

    landmarks: int
    images: int
    skipped: dict[str, int]
    left_out: dict[str, int]
    seen: dict[str, int]
    ground_alt_m: float
    common_sigma_m: tuple[float, float]
    torn: bool


def learn(
    log: Path, rig: StereoRig, config: Config, how: LearnConfig | None = None, progress: Callable[[float], None] = lambda _: None
) -> tuple[LandmarkMap, LearnSummary]:
    """The map of a log's images. Raises LearnError, LogError."""
    cv2.setNumThreads(1)
    how = how or LearnConfig()
    rectified = _rectified(rig)
    messages, torn = _read(log, config)
    progress(_READ)
    smoothed = smooth(messages, config.fusion(), lambda done: progress(_READ + (_SMOOTHED - _READ) * done))
    if smoothed.place is None or not len(smoothed.t_ns):
        raise LearnError(f"{log}: no pose comes out of its sensors (landfix doctor says what the log lacks)")
    origin = Origin(*smoothed.place)
    ground_d = _ground(messages, origin, how)
    mapper, skipped, images = Mapper(ground_d, how.mapping), Counter[str](), 0
    for pair, done in _pairs(log, config, how, rig):
        progress(_SMOOTHED + (1.0 - _SMOOTHED) * done)
        observations = _look(pair, images, smoothed, rectified, ground_d, how)
        if isinstance(observations, str):
            skipped[observations] += 1
        else:
            mapper.add(observations)
            images += 1
    if not images:
        reasons = ", ".join(f"{count} x {reason}" for reason, count in skipped.most_common()) or "there is none"
        raise LearnError(f"{log}: no image could be used: {reasons}")
    found = learned(mapper, ground_d, how.keep)
    common = float(np.sqrt(0.5 * np.trace(found.common[:2, :2]))), float(np.sqrt(found.common[2, 2]))
    the_map = LandmarkMap.from_landmarks(origin.lla, found.landmarks, common)
    the_map.automatic = True  # what stood still during the flight may have moved since
    seen = {mark.id: count for mark, count in zip(found.landmarks, found.seen, strict=True)}
    ground_alt = origin.to_geodetic((0.0, 0.0, ground_d))[2]
    return the_map, LearnSummary(
        len(the_map), images, dict(skipped), found.left_out, seen, round(ground_alt, 2), common, torn
    )  # fmt: skip


def _rectified(rig: StereoRig) -> Rectification:
    try:
        return rectification(rig)
    except ValueError as error:
        raise LearnError(str(error)) from None


def _read(log: Path, config: Config) -> tuple[list[Input], bool]:
    """Inputs without fixes of a map, whose errors would return as new; and whether torn."""
    decoder = config.decoder()
    with LogReader(log) as reader:
        decoded = (decoder.decode(r.topic, r.schema, r.data, r.log_time_ns) for r in reader)
        return [message for message in decoded if message and not isinstance(message, LandmarkFix)], reader.torn


def _ground(messages: list[Input], origin: Origin, how: LearnConfig) -> float:
    if how.ground_alt_m is not None:
        return origin.to_ned(origin.lat_deg, origin.lon_deg, how.ground_alt_m)[2]
    fixes = [m for m in messages if isinstance(m, GnssFix) and m.status >= 0]
    first = [m for m in fixes if m.t_ns - fixes[0].t_ns <= _STANDING_S * 1e9]
    downs = [origin.to_ned(m.lat_deg, m.lon_deg, m.alt_m)[2] for m in first]
    if not downs:
        raise LearnError("the log has no GNSS fix that says where the ground is: give --ground-alt-m")
    return float(np.median(downs))


def _pairs(log: Path, config: Config, how: LearnConfig, rig: StereoRig) -> Iterator[tuple[Pair, float]]:
    sides = {**dict.fromkeys(config.inputs.left_image, "left"), **dict.fromkeys(config.inputs.right_image, "right")}
    pairing = Pairing(msgspec.structs.replace(config.vision, most_hz=how.most_hz))
    offset_ns = round(rig.time_offset_s * 1e9)
    with LogReader(log) as reader:
        for record in reader:
            stamp_ns = stamp_of(record.data) if record.topic in sides else None
            if stamp_ns is not None:
                shot = Shot(record.topic, record.schema, record.data, stamp_ns, stamp_ns + offset_ns, record.log_time_ns)
                for pair in pairing.put(sides[record.topic], shot):
                    yield pair, reader.fraction


def _look(
    pair: Pair, frame: int, smoothed: Smoothed, rectified: Rectification, ground_d: float, how: LearnConfig
) -> list[Observation] | str:
    pose = _pose(smoothed, pair.t_ns)
    if pose is None:
        return "no pose"
    if float(np.sqrt(np.linalg.eigvalsh(pose.covariance[:2, :2])[-1])) > how.most_sigma_m:
        return f"pose sigma above {how.most_sigma_m:g} m"
    if ground_d - pose.p_n[2] < _LOWEST_M:
        return f"lower than {_LOWEST_M:g} m above the ground"
    if pair.left is None or pair.right is None:
        return "one image without the other"
    try:
        left, right = (decode_image(shot.schema, shot.data) for shot in (pair.left, pair.right))
    except ImageError as error:
        return str(error)
    limits = Limits(least_px=how.least_px)
    seen = survey(left, right, rectified, Settings(tuple(how.colours_bgr), limits=limits))
    if isinstance(seen, str):
        return seen
    observations = (observe(frame, region, m, pose, rectified.rig, ground_d, how.mapping) for region, m in _regions(seen))
    return [one for one in observations if one is not None]


def _pose(smoothed: Smoothed, t_ns: int) -> Prior | None:
    k = int(np.argmin(np.abs(smoothed.t_ns - t_ns)))
    node_ns = int(smoothed.t_ns[k])
    if abs(node_ns - t_ns) > _OLDEST_NS:
        return None
    node = Estimate(node_ns, node_ns, smoothed.nav[k], smoothed.covariance[k], vec3(smoothed.gyro_b[k]), Mode.AIDED, 0, node_ns)
    return Prior(*prior_at(node, t_ns))


def _regions(seen: Survey) -> Iterator[tuple[Region, Measured | None]]:
    least = _DARK * float(np.median(seen.left.max(axis=2) if seen.left.ndim == 3 else seen.left))
    measured = [(m.region, None if seen.problem else m) for m in seen.measured]
    for region, m in [*measured, *((u.region, None) for u in seen.unmeasured)]:
        if region.corners is not None and not region.touches_border and max(region.colour_bgr) > least:
            yield region, m
