"""landfix bench recognition."""

from typing import Annotated

import typer

from estimator.commands.common.clone import of_clone
from estimator.commands.common.console import Json, print_json, progress
from estimator.commands.common.groups import Group

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
    json: Json = False,
) -> None:
    """Recognise landmarks in rendered stereo pairs: four experiments.

    Accuracy and speed; roofs of one texture and other sizes; roofs of which 30 to 70 % are in view; landmarks known by their
    description only. Compares landfix, the plain method of the thesis, and SIFT + FLANN on the same images. Recognised: named,
    and the position agrees with the truth. A method without an answer gets the next pair. Times are CPU times of one core.
    It runs in a clone of the repository.

    \b
    Examples:
      landfix bench recognition
      landfix bench recognition --samples 20 --experiment partial --roof pale
      landfix bench recognition --samples 1000 --seed 1 --json
    """
    views, experiment = (of_clone(f"recognition.{name}", "bench") for name in ("views", "experiments"))
    chosen, kinds = _chosen(experiments, views.EXPERIMENTS, "--experiment"), _chosen(roofs, views.ROOFS, "--roof")
    with progress("recognition") as report:
        result = experiment.run(samples, seed, pairs, chosen, kinds, jobs, report)
    if json:
        print_json(result)
    else:
        of_clone("recognition.table", "bench").show(result)


def _chosen(wanted: list[str] | None, known: tuple[str, ...], option: str) -> tuple[str, ...]:
    for name in wanted or ():
        if name not in known:
            raise typer.BadParameter(f"'{name}' is none of {', '.join(known)}", param_hint=option)
    return tuple(name for name in known if not wanted or name in wanted)
