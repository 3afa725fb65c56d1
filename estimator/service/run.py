"""`landfix run`: starts and stops the daemon."""

import gc
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

from estimator.frontend.key_frames import VisualOdometryConfig
from estimator.frontend.requests import Track, VisionConfig
from estimator.fusion import EstimatorConfig, Fusion, FusionConfig
from estimator.map_files.image_file import ImageFile
from estimator.publish import OVERLAY_TOPIC, OutputConfig, Publisher, file_attachment
from estimator.service.autopilot.output_policy import AutopilotConfig, OutputPolicy, Px4Config
from estimator.service.base.clock import SECOND_NS, Clock, ClockConfig, Stamps
from estimator.service.base.mailbox import Mailbox
from estimator.service.base.ports import Arrival, Outbox
from estimator.service.base.priority import precede
from estimator.service.base.status import Status
from estimator.service.causes import CauseFinder
from estimator.service.console import Console
from estimator.service.daemon import Daemon, ServiceConfig
from estimator.service.log import state_file
from estimator.service.log.recovery import FolderLock, recover_in_background
from estimator.service.log.state_file import StateKeeper
from estimator.service.log.writer import LogConfig, LogWriter
from estimator.service.mavlink.config import MavlinkConfig
from estimator.service.vision.odometry import OdometryWorker
from estimator.service.vision.worker import VisionWorker
from estimator.service.warm_up import warm_up
from estimator.service.watchdog import Notifier
from estimator.service.zenoh.bus import ZenohBus
from estimator.service.zenoh.config import ZenohConfig
from estimator.service.zenoh.px4_link import Px4Link
from estimator.strict_toml import ConfigError
from estimator.version import version
from logs.store.reader import Attachment
from logs.store.recorder import CONFIG_ATTACHMENT
from logs.wire import schemas
from logs.wire.codec import CHECKPOINT_TOPIC, TICK_TOPIC, Decoder, ImuMounting, Topics
from models.untrusted.file import content

if TYPE_CHECKING:
    from estimator.service.mavlink.link import MavlinkLink

_STOP_SIGNALS: Final = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1, signal.SIGUSR2)
_SWITCH_S: Final = 1e-3  # a thread that computes gives way after this: the loop must not wait 5 ms for the log


class RunConfig(Protocol):
    """Configuration of the daemon (estimator.config.Config)."""

    @property
    def service(self) -> ServiceConfig: ...  # noqa: D102
    @property
    def clock(self) -> ClockConfig: ...  # noqa: D102
    @property
    def log(self) -> LogConfig: ...  # noqa: D102
    @property
    def zenoh(self) -> ZenohConfig: ...  # noqa: D102
    @property
    def autopilot(self) -> AutopilotConfig: ...  # noqa: D102
    @property
    def px4(self) -> Px4Config: ...  # noqa: D102
    @property
    def vision(self) -> VisionConfig: ...  # noqa: D102

    @property
    def visual_odometry(self) -> VisualOdometryConfig: ...  # noqa: D102
    @property
    def mavlink(self) -> MavlinkConfig: ...  # noqa: D102
    @property
    def estimator(self) -> EstimatorConfig: ...  # noqa: D102
    @property
    def geoid_m(self) -> float: ...  # noqa: D102
    @property
    def output(self) -> OutputConfig: ...  # noqa: D102
    @property
    def inputs(self) -> Topics: ...  # noqa: D102
    def files(self) -> dict[str, str]: ...  # noqa: D102
    def map_image(self, folder: Path) -> ImageFile | None: ...  # noqa: D102
    def mounting(self) -> ImuMounting: ...  # noqa: D102
    def fusion(self) -> FusionConfig: ...  # noqa: D102
    def decoder(self) -> Decoder: ...  # noqa: D102
    def toml(self) -> str: ...  # noqa: D102


class Listener(Outbox, Protocol):
    """Takes part in the daemon's place (`landfix doctor --live`)."""

    def published(self, topic: str, schema: str) -> None:
        """Somebody publishes a topic, whether or not it is an input."""
        ...


def run(config: RunConfig, folder: Path, *, quiet: bool = False) -> None:
    """Fly until SIGTERM or SIGINT; folder: of the configuration's files; quiet: errors only.

    Raises ConfigError, FolderError or BusError before the start only.
    """
    precede()
    notifier = Notifier()
    with (
        Console(quiet=quiet) as console,
        assembled(config, folder, alive=notifier.alive, console=console) as daemon,
        _until_signalled(daemon),
    ):
        for line in _greeting(config):
            console.say(line)
        notifier.ready("running")
        daemon.run()
        notifier.stopping()
        console.say("stopping: the log is being closed")


def _greeting(config: RunConfig) -> Iterator[str]:
    zenoh, mavlink, inputs = config.zenoh, config.mavlink.endpoint, config.inputs
    if zenoh.enabled:
        connects = f", connects to {', '.join(zenoh.connect)}" if zenoh.connect else ""
        yield f"Zenoh: listens on {', '.join(zenoh.listen) or 'nothing'}{connects}, ROS domain {zenoh.domain}"
    if mavlink:
        yield f"MAVLink: {mavlink}"
    if not (zenoh.enabled or mavlink):
        yield "no input: Zenoh and MAVLink are both off ([zenoh] enabled, [mavlink] endpoint)"
    yield f"waiting for: IMU samples on {', '.join(inputs.imu)}"


@contextmanager
def assembled(
    config: RunConfig,
    folder: Path,
    *,
    clock: Clock | None = None,
    alive: Callable[[], None] = lambda: None,
    console: Console | None = None,
    listener: Listener | None = None,
) -> Iterator[Daemon]:
    """The daemon with log, links and last state, open for the context; a listener gets what the links would send."""
    console = console or Console()
    attachments = _attachments(config, folder)
    console.say("loading kernels; the first start on a machine compiles them, which takes a minute or more")
    digest = sha256(config.toml().encode()).hexdigest()
    warm_up()
    logs = Path(config.log.folder)
    state_path = logs / config.service.state_file if config.service.state_file else None
    with ExitStack() as stack:
        hold: Callable[[], None] = (
            stack.enter_context(FolderLock(logs)).hold if config.log.enabled or state_path else lambda: None
        )
        saved, why = state_file.load(state_path) if state_path else (None, "")
        if why:
            console.say(f"{state_path}: {why}; the daemon starts anew, and writes it anew")
        clock = clock or state_file.clock_of(saved)
        if config.log.enabled and (recovery := recover_in_background(logs)):
            threading.Thread(target=recovery.wait, name="recovery", daemon=True).start()  # it may take longer than we live
        log = _log(stack, config, clock, attachments, _metadata(config, folder, digest), console, hold)
        keeper = _keeper(stack, state_path, clock, digest)
        stamps, images = Stamps(clock, config.clock), config.inputs.left_image + config.inputs.right_image
        bus = _bus(stack, config, folder, clock, images)
        mailbox = Mailbox(clock, log, images, config.mounting())
        parts = {"clock": stamps.report, "log": log.report, "inbox": mailbox.report}
        if keeper:
            parts["state"] = keeper.report
        outboxes: list[Outbox] = [bus] if bus else []
        px4: Px4Link | None = None
        if bus:
            parts["zenoh"] = bus.report
        if bus and config.px4.enabled:
            px4 = _px4(config, bus, clock)
            parts["px4"] = px4.report
            outboxes.append(px4)
        mavlink = _mavlink(stack, config, folder, clock, console)
        if mavlink:
            parts["mavlink"] = mavlink.report
            outboxes.append(mavlink)
        status, track = Status(clock.now_ns(), parts), Track()
        if vision := _vision(stack, config, folder, clock, track, mailbox, bus):
            parts["vision"] = vision.report
        if odometry := _odometry(stack, config, folder, clock, track, mailbox):
            parts["visual_odometry"] = odometry.report
        if vision and odometry:
            mailbox.see = _both(vision.put, odometry.put)
        elif worker := vision or odometry:
            mailbox.see = worker.put
        daemon = Daemon(
            fusion=Fusion(config.fusion()),
            decoder=config.decoder(),
            publisher=Publisher(config.output),
            mailbox=mailbox,
            outboxes=[listener] if listener else outboxes,
            log=log,
            stamps=stamps,
            clock=clock,
            status=status,
            track=track,
            alive=alive,
            watchers=[console.note, *(part.note for part in (keeper, _causes(stack, config, log, console)) if part)],
        )
        if last := state_file.usable(saved, clock.now_ns(), digest, config.service.warm_restart_s):
            daemon.take(Arrival(CHECKPOINT_TOPIC, schemas.CHECKPOINT, last.checkpoint, clock.now_ns()))
        if bus:
            _serve(bus, status, attachments)
            bus.watch_domains(config.inputs.imu, console.say)
            if listener:
                bus.watch_publishers(listener.published)
            bus.open_inputs(mailbox)
        if px4:
            px4.open_inputs(mailbox, config.inputs)
        if mavlink:
            mavlink.open_inputs(mailbox)
        yield daemon


def _vision(
    stack: ExitStack, config: RunConfig, folder: Path, clock: Clock, track: Track, mailbox: Mailbox, bus: ZenohBus | None
) -> VisionWorker | None:
    files, inputs, image = config.files(), config.inputs, config.map_image(folder)
    if "calibration" not in files or not ("map" in files or image):
        return None
    sides = {**dict.fromkeys(inputs.left_image, "left"), **dict.fromkeys(inputs.right_image, "right")}
    landmarks = folder / files["map"] if "map" in files else None
    where = folder / files["calibration"], landmarks, config.fusion().origin, image
    screen = bus.screen(OVERLAY_TOPIC, schemas.COMPRESSED_IMAGE) if bus else None
    stamps, overlay_hz = Stamps(clock, config.clock), config.output.overlay_hz
    worker = VisionWorker(where, config.vision, sides, clock, stamps, track, mailbox.put_own, screen, overlay_hz)
    stack.callback(worker.close)
    return worker


def _both(first: Callable[[Arrival], None], second: Callable[[Arrival], None]) -> Callable[[Arrival], None]:
    def see(arrival: Arrival) -> None:
        first(arrival)
        second(arrival)

    return see


def _odometry(
    stack: ExitStack, config: RunConfig, folder: Path, clock: Clock, track: Track, mailbox: Mailbox
) -> OdometryWorker | None:
    files, inputs = config.files(), config.inputs
    if not config.visual_odometry.enabled or "calibration" not in files:
        return None
    sides = {**dict.fromkeys(inputs.left_image, "left"), **dict.fromkeys(inputs.right_image, "right")}
    worker = OdometryWorker(
        folder / files["calibration"], config.visual_odometry, config.vision, sides, clock, Stamps(clock, config.clock), track,
        mailbox.put_own,
    )  # fmt: skip
    stack.callback(worker.close)
    return worker


def _attachments(config: RunConfig, folder: Path) -> list[Attachment]:
    kept = Attachment(CONFIG_ATTACHMENT, "application/toml", config.toml().encode())
    return [kept, *(file_attachment(kind, folder / file) for kind, file in config.files().items())]


def _serve(bus: ZenohBus, status: Status, attachments: list[Attachment]) -> None:
    bus.serve("status", status.json, "application/json")
    content = {a.name.partition("/")[0]: a.data for a in attachments}
    bus.serve("config", lambda: content[CONFIG_ATTACHMENT], "application/toml")
    bus.serve("calibration", lambda: content.get("calibration"), "application/octet-stream")
    bus.serve("map", lambda: content.get("map"), "application/geo+json")


class _NoLog:
    def put_input(self, *_: object) -> None:
        """Keep nothing."""

    put_output = put_image = put_input

    def report(self) -> dict[str, Any]:
        return {"state": "off"}


def _metadata(config: RunConfig, folder: Path, digest: str) -> dict[str, str]:
    known = {"version": version(), "config_sha256": digest}
    image = config.map_image(folder)
    if image is None:
        return known
    try:
        return known | {"picture": image.path.name, "picture_sha256": sha256(content(image.path)).hexdigest()}
    except OSError as error:
        raise ConfigError(f"{image.path}: {(error.strerror or 'cannot be read').lower()}") from None


def _log(
    stack: ExitStack,
    config: RunConfig,
    clock: Clock,
    attachments: list[Attachment],
    metadata: dict[str, str],
    console: Console,
    hold: Callable[[], None],
) -> LogWriter | _NoLog:
    if not config.log.enabled:
        console.say("log: off ([log] enabled)")
        return _NoLog()
    began = datetime.fromtimestamp(clock.now_ns() / SECOND_NS, UTC)
    stem = Path(config.log.folder) / f"landfix-{began:%Y%m%dT%H%M%S}{began.microsecond // 1000:03d}Z"
    log = LogWriter(config.log, lambda n: stem.with_name(f"{stem.name}-{n:03d}.mcap"), metadata, attachments, hold)
    console.say(f"log: {stem}-*.mcap")
    stack.callback(lambda: console.closed(log.files, log.state.lost_inputs))  # callbacks run in reverse order: after log.close
    stack.callback(log.close)
    return log


def _causes(stack: ExitStack, config: RunConfig, log: LogWriter | _NoLog, console: Console) -> CauseFinder | None:
    if console.quiet or isinstance(log, _NoLog):
        return None
    finder = CauseFinder(config.toml(), lambda: log.state.file, console.say)
    stack.callback(finder.close)
    return finder


def _keeper(stack: ExitStack, path: Path | None, clock: Clock, digest: str) -> StateKeeper | None:
    if path is None:
        return None
    keeper = StateKeeper(path, clock, digest)
    stack.callback(keeper.close)
    return keeper


def _bus(stack: ExitStack, config: RunConfig, folder: Path, clock: Clock, images: Sequence[str]) -> ZenohBus | None:
    if not config.zenoh.enabled:
        return None
    topics = {topic: schema for topic, schema in config.decoder().types.items() if topic not in {TICK_TOPIC, CHECKPOINT_TOPIC}}
    bus = ZenohBus(config.zenoh, folder, clock, topics, images)
    stack.callback(bus.close)
    return bus


def _px4(config: RunConfig, bus: ZenohBus, clock: Clock) -> Px4Link:
    policy = OutputPolicy(config.autopilot)
    rate_hz = config.autopilot.odometry_hz
    return Px4Link(config.px4, bus.session, config.zenoh.domain, clock, policy, rate_hz, config.geoid_m)


def _mavlink(stack: ExitStack, config: RunConfig, folder: Path, clock: Clock, console: Console) -> "MavlinkLink | None":
    if not config.mavlink.endpoint:
        return None
    from estimator.service.mavlink.link import MavlinkLink  # noqa: PLC0415  (the dialect is loaded only where it is spoken)

    policy = OutputPolicy(config.autopilot)
    rate_hz = config.autopilot.odometry_hz
    level = config.visual_odometry.level
    link = MavlinkLink(config.mavlink, folder, config.inputs, clock, policy, rate_hz, config.geoid_m, console.say, level)
    stack.callback(link.close)
    return link


@contextmanager
def _until_signalled(daemon: Daemon) -> Iterator[None]:
    """Signals stop the daemon; ignored ones (nohup) stay so."""
    for number in _STOP_SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, lambda *_: daemon.stop())
    interval = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_S)
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(interval)
        for number in _STOP_SIGNALS:
            signal.signal(number, signal.SIG_IGN)
