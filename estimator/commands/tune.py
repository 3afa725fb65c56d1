"""landfix tune."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from estimator.commands.common.console import ConfigFile, Jobs, Json, Scheduler, note, print_json, print_table, progress

if TYPE_CHECKING:
    from estimator.tools.tune.search import Gain, Summary, TunedKey, TuneResult


class TuneError(ValueError):
    """Nothing to tune with."""


def command(
    logs: Annotated[
        list[str], typer.Argument(metavar="LOG.mcap...", help="Logs to tune on, local or in a store: sensors and absolute fixes.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="TUNED.toml", help="Configuration to write.")],
    config: ConfigFile = None,
    hold_out: Annotated[
        list[str] | None,
        typer.Option("--hold-out", metavar="LOG.mcap", help="Log for evaluation only, not for tuning; may be repeated."),
    ] = None,
    truth: Annotated[str, typer.Option(metavar="TOPIC", help="Poses to compare with; default: the held-out fixes.")] = "",
    vary: Annotated[
        str, typer.Option(metavar="KEY,KEY", help="Keys to tune, such as imu.gyro_noise; default: all noise parameters.")
    ] = "",
    outage_s: Annotated[
        float, typer.Option("--outage", metavar="SECONDS", min=1, help="Duration of a window without fixes.")
    ] = 10.0,
    coarse: Annotated[int, typer.Option(metavar="N", min=0, help="Evaluations of the coarse search.")] = 16,
    fine: Annotated[int, typer.Option(metavar="N", min=0, help="Evaluations of the fine search, at most.")] = 40,
    jobs: Jobs = None,
    scheduler: Scheduler = "",
    json: Json = False,
) -> None:
    """Find the noise parameters that best predict held-out fixes.

    Fixes are held out in windows of 10 s. The score is their likelihood: too small a covariance lowers it, and so does too large
    a one. No truth is needed. The loss at half and at double the value of a parameter is printed; none: weakly identifiable.

    \b
    Examples:
      landfix tune monday.mcap tuesday.mcap -c vehicle.toml -o tuned.toml --hold-out friday.mcap
      landfix tune *.mcap -c vehicle.toml -o tuned.toml --scheduler tcp://10.0.0.5:8786
    """
    from os.path import realpath

    from estimator.config import load
    from estimator.tools.fleet.engine import executor
    from estimator.tools.fleet.store import is_stored
    from estimator.tools.tune.keys import chosen, written
    from estimator.tools.tune.score import sources
    from estimator.tools.tune.search import TuneConfig, Tuner
    from logs.store.reader import check_output

    text = load(config).toml()
    names, held_out = ([log if is_stored(log) else realpath(log) for log in some] for some in (logs, hold_out or ()))
    if again := set(names) & set(held_out):
        raise TuneError(f"{min(again)}: is tuned on, so it cannot be held out")
    check_output(out, *(Path(log) for log in (*names, *held_out) if not is_stored(log)))
    keys = chosen(sources(names[0], text), filter(None, vary.split(",")), bool(truth))
    with executor(jobs, scheduler) as workers, progress(f"tune {len(keys)} keys") as report:
        tuner = Tuner(names, text, keys, TuneConfig(coarse, fine, outage_s, truth), workers, report)
        result = tuner.run(held_out)
    out.write_text(written(config.read_text(encoding="utf-8") if config else "", result.values), encoding="utf-8")
    if json:
        print_json(result)
    else:
        _print(result, out)


def _print(result: "TuneResult", out: Path) -> None:
    from estimator.tools.tune.search import warning

    rows = [_row("before", result.before), _row("tuned", result.after)]
    if result.held_out_before and result.held_out_after:
        rows += [_row("held out, before", result.held_out_before), _row("held out, tuned", result.held_out_after)]
    header = ("", "windows", "score per fix", "NIS/dof", "inside 95 %", "error", "false")
    print_table(f"{len(result.logs)} logs, {result.evaluations} evaluations", rows, header)
    typer.echo(
        f"gain per fix: {_gain(result.gain)}" + (f"; held out: {_gain(result.held_out_gain)}" if result.held_out_gain else "")
    )
    typer.echo("")
    columns = ("key", "before", "tuned", "half", "double", "identifiable")
    print_table("Parameters; half, double: gain per fix if it were so", [_key(key) for key in result.keys], columns)
    typer.echo(f"\nwritten: {out}")
    if against := warning(result):
        note(f"landfix: {against}")


def _row(name: str, s: "Summary") -> tuple[str, ...]:
    error, false = f"{s.position_rms_m:.2f} m", f"{s.false} of {s.fixes}"
    return name, str(s.windows), f"{s.score:.2f}", f"{s.nis_per_dof:.2f}", f"{s.inside95:.0%}", error, false


def _key(key: "TunedKey") -> tuple[str, ...]:
    verdict = "at its bound" if key.at_bound else "yes" if key.determined else "weakly"
    return key.name, f"{key.before:.3g}", f"{key.after:.3g}", _gain(key.half), _gain(key.double), verdict


def _gain(gain: "Gain") -> str:
    return f"{gain.mean:+.2f}±{gain.error:.2f}"
