"""landfix fleet run."""

from typing import TYPE_CHECKING, Annotated

import typer

from estimator.commands.common.console import ConfigFile, Jobs, Json, Scheduler, note, print_json, print_table, progress

if TYPE_CHECKING:
    from estimator.tools.fleet.run import RunSummary

_MOST_LINES = 10


def command(
    logs: Annotated[
        list[str],
        typer.Argument(metavar="LOGS...", help="Addresses, globs of them, or a list file (.txt): local, s3://, gs:// ..."),
    ],
    results: Annotated[str, typer.Option("--out", "-o", metavar="RESULTS", help="Folder of the rows, local or in a store.")],
    config: ConfigFile = None,
    label: Annotated[str, typer.Option(metavar="NAME", help="Name of this run, to compare it with others.")] = "run",
    truth: Annotated[str, typer.Option(metavar="TOPIC", help="Topic of the reference.")] = "/truth",
    from_images: Annotated[bool, typer.Option("--from-images", help="Read the images too, and process them again.")] = False,
    scheduler: Scheduler = "",
    jobs: Jobs = None,
    json: Json = False,
) -> None:
    """Replay and evaluate many logs, one row each.

    A row holds errors and consistency (against a reference where the log has one, by innovations where it has none), outages,
    refusals by reason, protection levels and costs, or why the log failed. What has a row is not computed again. Without -c each
    log is replayed with the configuration it was recorded or imported with. The exit code is 1 if a log has no row.

    \b
    Examples:
      landfix fleet run 'logs/*.mcap' -c vehicle.toml -o results --label before
      landfix fleet run 's3://flights/2026/*.mcap' -c vehicle.toml -o s3://flights/results --label after
      landfix fleet run flights.txt -o results --scheduler tcp://10.0.0.5:8786
    """
    from estimator.tools.fleet.engine import cluster
    from estimator.tools.fleet.run import run, settings_of
    from estimator.tools.fleet.store import flights

    settings, found = settings_of(label, config, truth, from_images=from_images), flights(logs)
    with cluster(jobs, scheduler) as client:
        note(f"landfix: {len(found)} flights, dashboard {client.dashboard_link}")
        with progress("fleet") as report:
            summary = run(found, settings, results, client, report)
    if json:
        print_json(summary)
    else:
        _print(summary, results)
    for log, why in list(summary.unfinished.items())[:_MOST_LINES]:
        note(f"landfix: {log}: no row: {why}")
    if summary.unfinished:
        note(f"landfix: {len(summary.unfinished)} flights have no row; the same command tries them again")
        raise typer.Exit(1)


def _print(summary: "RunSummary", results: str) -> None:
    share = summary.read_bytes / summary.stored_bytes if summary.stored_bytes else 0.0
    rows = [
        ("flights", f"{summary.flights}, {summary.known} with a row before, {summary.done} done now"),
        ("failed", f"{summary.failed} (landfix fleet show {results} --failed)" if summary.failed else "0"),
        ("flight hours", f"{summary.hours:.2f}, {summary.hours_a_core_hour:.0f} a core hour"),
        ("read", f"{summary.read_bytes / 1e6:.1f} MB, {share:.1%} of what is stored"),
        ("memory of a worker", f"{summary.memory_mb:.0f} MB at most"),
    ]
    print_table(f"{results}, label {summary.label}", rows)
