"""landfix replay."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from estimator.commands.common.console import ConfigFile, Json, Out, kept_on_interrupt, note, print_json, print_table, progress

if TYPE_CHECKING:
    from estimator.config import Config
    from estimator.replay.summary import ReplaySummary
    from logs.store.reader import Attachment


def command(
    source: Annotated[
        list[Path], typer.Argument(metavar="IN.mcap...", help="Log with the sensors' messages; all its parts, or their folder.")
    ],
    out: Out,
    config: ConfigFile = None,
    from_images: Annotated[
        bool, typer.Option("--from-images/--from-fixes", help="Process the recorded images again, or use the fixes in the log.")
    ] = False,
    without_odometry: Annotated[
        bool, typer.Option("--without-odometry", help="Leave increments and poses of odometry out, to see what they are worth.")
    ] = False,
    smooth: Annotated[
        bool, typer.Option("--smooth", help="Add /landfix/smoothed: the estimate of each moment from the whole flight.")
    ] = False,
    json: Json = False,
) -> None:
    """Run a log through the estimator.

    The output is bit-identical to what the flight would have published with this configuration. A log that was rotated into
    parts is one flight: give all of them, in any order, or their folder. OUT.mcap holds the input's messages as they are,
    /landfix/odometry with covariance at every IMU sample, and the decision on every measurement with its reason
    (/landfix/aid_status). Without an estimate the last line says why and what to do, and the exit code is 1.

    \b
    Examples:
      landfix replay flight.mcap -o estimate.mcap -c vehicle.toml
      landfix replay logs/landfix-20260501T101500000Z-*.mcap -o estimate.mcap -c vehicle.toml
      landfix replay flight.mcap -o smoothed.mcap -c vehicle.toml --smooth
      landfix replay flight.mcap -o again.mcap -c vehicle.toml --from-images     rig and map as the configuration names them
    """
    with kept_on_interrupt(lambda: [out]), progress(f"replay {source[0].name}") as report:  # it moves while libraries are loaded
        from estimator.config import load
        from estimator.replay.from_images import seen_again
        from estimator.replay.replay import replay
        from logs.findings import together
        from logs.store.parts import files_of

        loaded, folder = load(config), config.parent if config else Path()
        parts = [file for given in source for file in files_of(given)]
        processor = seen_again(loaded, folder, parts) if from_images else None
        summary = replay(parts, out, loaded, report, processor, _attachments(loaded, folder), odometry=not without_odometry)
    if smooth and not summary.advice:
        _add_smoothed(out, loaded)
    for again in processor.parts if processor else ():
        note(f"landfix: {again.counts}")
    for name in summary.torn_parts:
        note(f"landfix: {name} is truncated; replayed up to its last whole record")
    if summary.missing:
        note(f"landfix: without {summary.missing} of this flight the estimate aligns anew, and is not the one that was flown")
    if json:
        print_json(summary)
    else:
        print_summary(summary, out)
    found = together(summary.findings)
    for finding in found[:1]:
        more = f" ({len(found) - 1} more: landfix doctor)" if len(found) > 1 else ""
        note(f"landfix: at fault: {finding}{more}")
    if summary.remark:
        note(f"landfix: {summary.remark}")
    if summary.advice:
        note(f"landfix: no estimate: {summary.advice}")
    if summary.advice or any(finding.unfit for finding in summary.findings):
        raise typer.Exit(1)


def _attachments(config: "Config", folder: Path) -> "list[Attachment]":
    from estimator.config import ConfigError
    from estimator.publish import file_attachment

    found = []
    for kind, file in config.files().items():
        try:
            found.append(file_attachment(kind, folder / file))
        except ConfigError as error:
            note(f"landfix: {error}; the output keeps the log's {kind}, if that has one")
    return found


def _add_smoothed(log: Path, config: "Config") -> None:
    from estimator.replay.smooth_log import write_smoothed

    whole = log.with_name(f".{log.name}.smoothing")
    try:
        with kept_on_interrupt(lambda: [log]), progress(f"smooth {log.name}") as report:
            summary = write_smoothed(log, whole, config, report)
        whole.replace(log)
    finally:
        whole.unlink(missing_ok=True)
    note(f"landfix: /landfix/smoothed: {summary.nodes} poses, none less certain than {summary.worst_sigma_m:.2f} m (1 sigma)")


def print_summary(summary: "ReplaySummary", out: Path) -> None:
    """The summary as a person reads it."""
    rows = [
        ("log", f"{summary.duration_s:.1f} s, {summary.records} messages" + (", torn" if summary.torn else "")),
        ("speed", f"{summary.speed:.0f} x real time ({summary.elapsed_s:.1f} s)"),
        ("IMU samples", f"{summary.imu_samples} -> {summary.estimates} estimates"),
        ("first estimate", _first_estimate(summary)),
        *((f"{topic}", _reasons(reasons)) for topic, reasons in summary.fixes.items()),
        ("modes", ", ".join(f"{mode} {s:.1f} s" for mode, s in summary.modes_s.items()) or "no estimate"),
        ("longest outage", _outage(summary)),
        ("worst 95 % radius", "-" if summary.worst_radius95_m is None else f"{summary.worst_radius95_m:.2f} m in health"),
        ("resets", str(summary.resets)),
        ("internal errors", str(summary.internal_errors)),
    ]
    print_table(f"{out}", rows)


def _outage(summary: "ReplaySummary") -> str:
    if not summary.estimates:
        return "-"
    s = summary.longest_without_absolute_s
    return f"{s:.1f} s without an absolute fix" if s else "none: absolute fixes throughout"


def _first_estimate(summary: "ReplaySummary") -> str:
    if summary.first_estimate_s is None:
        return f"none: {summary.waited_for}" if summary.waited_for else "none"
    return f"{summary.first_estimate_s:.1f} s after the log's first message"


def _reasons(reasons: dict[str, int]) -> str:
    return ", ".join(f"{n} {reason}" for reason, n in sorted(reasons.items(), key=lambda item: -item[1]))
