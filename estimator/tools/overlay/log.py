"""An overlay's data of a log: estimates at exposures, identifications, images."""

from bisect import bisect_right
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from estimator.frontend.residuals import View
from logs.evaluation.collected import ODOMETRY_TOPIC
from logs.evaluation.evaluate import LONGEST_STEP_NS
from logs.evaluation.trajectory import decode, interpolate
from logs.store.reader import Attachment, LogError, LogReader, Record
from logs.wire import axes, schemas
from logs.wire.codec import VISION_REQUEST_TOPIC, Decoder, decode_diagnostics, decode_vision_request
from logs.wire.images import ImageError, decode_image
from logs.wire.stamps import stamp_of
from models import so3
from models.messages import ImageName, LandmarkFix, vec3
from models.radius import horizontal_radius
from vision.image.rectify import Image

FIX_TOPIC: Final = "/landfix/fix"
HEALTH_TOPIC: Final = "/landfix/health"
_IMAGES: Final = (schemas.IMAGE, schemas.COMPRESSED_IMAGE)
_PROGRESS_EVERY: Final = 2000  # records
_SPACING_NS: Final = 8_000_000  # of the estimates kept: hours fit into memory, and a turn of 10 rad/s^2 is off by 0.1 px


@dataclass(slots=True)
class Flight:
    """A log without pixels.

    stamps_ns: by image topic; exposures_ns: of requests; identified: landmarks by exposure.
    """

    path: Path
    odometry: list[tuple[bytes, int]] = field(default_factory=list)
    stamps_ns: dict[str, list[int]] = field(default_factory=dict)
    exposures_ns: dict[ImageName, int] = field(default_factory=dict)
    identified: dict[int, frozenset[str]] = field(default_factory=dict)
    modes: list[tuple[int, str]] = field(default_factory=list)
    attachments: list[Attachment] = field(default_factory=list)
    _kept_ns: int = -_SPACING_NS

    @property
    def used(self) -> frozenset[str]:
        """Landmarks of all fixes."""
        return frozenset[str]().union(*self.identified.values())

    def take(self, record: Record) -> None:
        """Keep a record's relevant data."""
        if record.topic == ODOMETRY_TOPIC:
            stamp_ns = stamp_of(record.data) or 0
            if not 0 <= stamp_ns - self._kept_ns < _SPACING_NS:
                self.odometry.append((record.data, record.log_time_ns))
                self._kept_ns = stamp_ns
        elif record.schema in _IMAGES:
            self.stamps_ns.setdefault(record.topic, []).append(stamp_of(record.data) or 0)
        elif record.topic == VISION_REQUEST_TOPIC:
            request = decode_vision_request(record.data, record.log_time_ns)
            self.exposures_ns |= {name: request.t_ns for name in (request.left, request.right) if name is not None}
        elif record.topic == FIX_TOPIC:
            fix = Decoder().decode(record.topic, record.schema, record.data, record.log_time_ns)
            if isinstance(fix, LandmarkFix):
                self.identified[fix.t_ns] = frozenset(fix.landmarks)
        elif record.topic == HEALTH_TOPIC:
            self.modes.append((stamp_of(record.data) or 0, decode_diagnostics(record.data).get("mode", "")))

    def topic_of(self, topics: Sequence[str]) -> str:
        """The topic with images. Raises LogError without images or estimate."""
        if not self.odometry:
            raise LogError(
                f"{self.path}: holds no {ODOMETRY_TOPIC}; make an estimate first: landfix replay {self.path} -o estimate.mcap"
            )
        found = [topic for topic in topics if topic in self.stamps_ns]
        if not found:
            others = f"; it holds images on {', '.join(sorted(self.stamps_ns))}" if self.stamps_ns else ""
            raise LogError(f"{self.path}: holds no images on {', '.join(topics)}{others}")
        return found[0]


def read(path: Path, progress: Callable[[float], None] = lambda _: None) -> Flight:
    """The Flight of a log. Raises LogError."""
    flight = Flight(path)
    with LogReader(path) as reader:
        for count, record in enumerate(reader):
            flight.take(record)
            if count % _PROGRESS_EVERY == 0:
                progress(reader.fraction)
        flight.attachments = reader.attachments
    return flight


def views(flight: Flight, topic: str, time_offset_s: float) -> list[View | None]:
    """Estimate at each image's exposure, or None."""
    offset_ns, exposures = round(time_offset_s * 1e9), []
    for stamp_ns in flight.stamps_ns[topic]:
        exposures.append(flight.exposures_ns.get(ImageName(topic, stamp_ns), stamp_ns + offset_ns))
        offset_ns = exposures[-1] - stamp_ns
    estimate = decode(schemas.ODOMETRY, [data for data, _ in flight.odometry], [arrived for _, arrived in flight.odometry])
    at, covered = interpolate(estimate, np.array(exposures, np.int64), LONGEST_STEP_NS)
    radius = horizontal_radius(at.covariance[:, :2, :2])
    began, names = [t for t, _ in flight.modes], [name for _, name in flight.modes]
    found: list[View | None] = [None] * len(exposures)
    for row, k in enumerate(np.flatnonzero(covered).tolist()):
        t_ns, q = exposures[k], at.q_wxyz[row]
        if np.isfinite(at.p[row]).all() and np.isfinite(q).all() and np.isfinite(at.covariance[row]).all():
            R_nb = so3.matrix(np.array(axes.attitude((q[0], q[1], q[2], q[3]))))
            last = bisect_right(began, t_ns) - 1
            mode = names[last] if last >= 0 else ""
            p_n, covariance = np.array(axes.world(vec3(at.p[row]))), axes.world_covariance(at.covariance[row])
            seen = flight.identified.get(t_ns, frozenset())
            found[k] = View(t_ns, p_n, R_nb, covariance, float(radius[row]), mode, seen)
    return found


def images(flight: Flight, topic: str, wanted: Collection[int]) -> Iterator[tuple[int, Image | None]]:
    """Number and pixels of the wanted images; None where unreadable."""
    last = max(wanted, default=-1)
    with LogReader(flight.path) as reader:
        for number, record in enumerate(record for record in reader if record.topic == topic and record.schema in _IMAGES):
            if number > last:
                return
            if number in wanted:
                try:
                    yield number, decode_image(record.schema, record.data)
                except ImageError:
                    yield number, None
