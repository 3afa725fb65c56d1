"""Visual odometry in its own process, independent of the landmark search."""

from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

from estimator.frontend.key_frames import KeyFrames, VisualOdometryConfig
from estimator.frontend.requests import Pair, Track, VisionConfig
from estimator.service.base.clock import Clock, Stamps
from estimator.service.vision.wire import Asked, Drawing
from estimator.service.vision.worker import Respond, VisionWorker, answer_until_closed
from logs.wire.codec import Encoded, decode_odometry_request, encode
from models.messages import ODOMETRY_DELTA_TOPIC


def serve_odometry(pipe: Connection, rig_file: Path) -> None:
    """The process: questions are a request and two pairs."""

    def load() -> tuple[int, Respond]:
        from estimator.frontend.files import load_odometry  # noqa: PLC0415  (OpenCV is loaded in this process only)

        processor = load_odometry(rig_file)

        def respond(to: Asked) -> list[Encoded]:
            return [] if isinstance(to, Drawing) else processor.process(decode_odometry_request(to.request, 0), *to.pairs)

        return processor.time_offset_ns, respond

    def warm() -> None:
        from estimator.service.vision.warm_up import warm_up_odometry  # noqa: PLC0415

        warm_up_odometry()

    answer_until_closed(pipe, load, warm)


class OdometryWorker(VisionWorker):
    """As VisionWorker, for pairs of key frames."""

    _measurement = ODOMETRY_DELTA_TOPIC

    def __init__(
        self,
        rig_file: Path,
        config: VisualOdometryConfig,
        vision: VisionConfig,
        sides: dict[str, str],
        clock: Clock,
        stamps: Stamps,
        track: Track,
        tell: Callable[[Encoded], None],
    ) -> None:
        self._key_frames = KeyFrames(config)
        super().__init__((rig_file,), vision, sides, clock, stamps, track, tell)

    @staticmethod
    def _target() -> Callable[..., None]:
        return serve_odometry

    def _question(self, pair: Pair, asked_ns: int) -> tuple[Encoded, list[Pair]] | None:
        asked = self._key_frames.request(pair, self._track, asked_ns)
        if asked is None:
            return None
        request, first = asked
        (message,) = encode(request)
        return message, [first, pair]
