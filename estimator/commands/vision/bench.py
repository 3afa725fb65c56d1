"""landfix bench recognition."""
# ruff: noqa: D301, PLC0415  (\b keeps line breaks in help; imported where needed, so that --help is fast)

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from estimator.commands.common.console import Json, note, print_json, print_table, progress
from estimator.commands.common.groups import Group

if TYPE_CHECKING:
    from rich.text import Text

    from estimator.bench.recognition import Recognition, Row

_Name = TypeVar("_Name", bound=str)

app = typer.Typer(
    cls=Group, no_args_is_help=True, help="Benchmark the recognition of landmarks against other methods.", rich_markup_mode=None
)


@app.callback()
def _bench() -> None:
    """Benchmark the recognition of landmarks against other methods."""


@app.command()
def recognition(
    samples: Annotated[int, typer.Option(min=1, max=100_000, help="Samples of each experiment and kind of roof.")] = 200,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of the samples.")] = 0,
    experiments: Annotated[
        list[str] | None, typer.Option("--experiment", help="accuracy, size, partial or description; repeat for more.")
    ] = None,
    roofs: Annotated[list[str] | None, typer.Option("--roof", help="painted or pale. Default: both.")] = None,
    pairs: Annotated[
        int, typer.Option(min=1, max=100, help="Largest number of pairs, half a second apart, for a method without an answer.")
    ] = 3,
    jobs: Annotated[int, typer.Option(min=0, help="Processes; 0: one a core.")] = 0,
    plot: Annotated[Path | None, typer.Option("--plot", metavar="FILE.png", help="Plot of the table.")] = None,
    json: Json = False,
) -> None:
    """Recognise landmarks in rendered stereo pairs: four experiments.

    Accuracy and speed; roofs of one texture and other sizes; roofs of which 30 to 70 % are in view; landmarks known by their
    description only. Compares landfix, the plain method of the thesis, and SIFT + FLANN on the same images. Recognised: named,
    and the position agrees with the truth. A method without an answer gets the next pair. Times are CPU times of one core.

    \b
    Examples:
      landfix bench recognition
      landfix bench recognition --samples 20 --experiment partial --roof pale
      landfix bench recognition --samples 1000 --seed 1 --plot recognition.png --json
    """
    from estimator.bench.recognition import run
    from estimator.bench.views import EXPERIMENTS, ROOFS

    chosen, kinds = _chosen(experiments, EXPERIMENTS, "--experiment"), _chosen(roofs, ROOFS, "--roof")
    with progress("recognition") as report:
        result = run(samples, seed, pairs, chosen, kinds, jobs, report)
    if plot is not None:
        from estimator.bench.plot import draw

        draw(result).savefig(plot)
    if json:
        print_json(result)
        return
    _print(result)


def _chosen(wanted: list[str] | None, known: tuple[_Name, ...], option: str) -> tuple[_Name, ...]:
    for name in wanted or ():
        if name not in known:
            raise typer.BadParameter(f"'{name}' is none of {', '.join(known)}", param_hint=option)
    return tuple(name for name in known if not wanted or name in wanted)


def _print(result: "Recognition") -> None:
    from estimator.bench.recognition import TITLES

    looks = (f"{k} pair{'s' * (k > 1)}" for k in range(1, result.pairs + 1))
    header = ("roofs", "method", *looks, "wrong", "wrong <", "ms", "p99", "m")
    for experiment in dict.fromkeys(r.experiment for r in result.rows):
        rows = [_cells(r) for r in result.rows if r.experiment == experiment]
        print_table(f"\n{TITLES[experiment]}: {result.samples} samples each", rows, header)
    note("pairs: recognised with so many at most; wrong <: upper 95 % bound of the share of wrong answers; ms: one core, a pair")
    note(f"key points of an image: median {result.key_points_p50:.0f}, least {result.key_points_least}")


def _cells(row: "Row") -> "list[str | Text]":
    from rich.text import Text

    shares = [k / row.samples for k in row.by_pair]
    return [
        row.roof,
        row.method,
        *(Text(f"{share:.1%}", "green" if share >= 0.95 else "") for share in shares),
        Text(str(row.wrong), "red" if row.wrong else "green"),
        f"{row.wrong_below:.1%}",
        _number(row.cpu_ms_p50, 0),
        _number(row.cpu_ms_p99, 0),
        _number(row.error_m_p50, 2),
    ]


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
