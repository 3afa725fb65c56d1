"""landfix live."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from estimator.commands.common.console import ConfigFile, note, progress

if TYPE_CHECKING:
    from estimator.service.live_server import LiveServer


def command(
    log: Annotated[Path | None, typer.Argument(metavar="[LOG.mcap]", help="Log to play; none: a running daemon.")] = None,
    config: ConfigFile = None,
    connect: Annotated[
        str | None, typer.Option("--connect", metavar="ENDPOINT", help="Where the daemon listens; default: as in FILE.")
    ] = None,
    speed: Annotated[float, typer.Option(min=0.01, metavar="X", help="Playback speed.")] = 1.0,
    host: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Address to listen on; 0.0.0.0: open to everybody, unprotected.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen on; 0: any free one.")] = 8765,
    wait: Annotated[bool, typer.Option("--wait/--at-once", help="Start playing at the first subscription.")] = True,
) -> None:
    """Show a running daemon, or play a log, in Foxglove (needs landfix[live]).

    In Foxglove: Open connection, Foxglove WebSocket, ws://localhost:8765; layout: examples/foxglove/landfix.json. Foxglove can
    also open a log file itself. This command only listens. /landfix/overlay is drawn as long as it runs.

    \b
    Examples:
      landfix live                                  the daemon on this machine
      landfix live --connect tcp/10.0.0.5:7447
      landfix live estimate.mcap --speed 4
    """
    from estimator.service.live_server import LiveServer

    with LiveServer(host, port) as server:
        note(f"landfix: ws://{host}:{server.port}  (Ctrl-C ends it)")
        try:
            if log is not None:
                _play(server, log, speed, wait)
            else:
                _relay(server, config, connect)
        except KeyboardInterrupt:
            note("landfix: ended")


def _play(server: "LiveServer", log: Path, speed: float, wait: bool) -> None:
    import time

    from estimator.service.live_server import play, topics_of

    with progress(f"read {log.name}") as report:
        server.offer(topics_of(log, report))
    while wait and not server.watched:
        time.sleep(0.1)
    with progress(f"play {log.name}") as report:
        count = play(server, log, speed, report)
    note(f"landfix: {count} messages played")


def _relay(server: "LiveServer", config: Path | None, connect: str | None) -> None:
    import signal

    from estimator.config import load
    from estimator.publish import OVERLAY_TOPIC
    from estimator.service import monitor
    from estimator.service.live_server import relay
    from estimator.service.zenoh.bus import OUTPUTS
    from logs.wire import cameras, schemas
    from logs.wire.markers import MARKERS, TOPIC

    loaded = load(config)
    topics = {
        **OUTPUTS,
        "/landfix/fix": schemas.LANDMARK_FIX,
        "/landfix/vision": schemas.VISION_REPORT,
        TOPIC: MARKERS,
        cameras.LEFT_TOPIC: schemas.CAMERA_INFO,
        cameras.RIGHT_TOPIC: schemas.CAMERA_INFO,
        cameras.STATIC_TOPIC: schemas.TF,
        OVERLAY_TOPIC: schemas.COMPRESSED_IMAGE,
    }
    with monitor.connected(loaded.zenoh, config.parent if config else Path(), connect) as (session, _):
        kept = relay(server, session, loaded.zenoh.domain, topics)
        signal.pause()
        kept.clear()
