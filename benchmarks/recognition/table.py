"""A recognition run as tables in a terminal."""

from rich.text import Text

from benchmarks.recognition.experiments import TITLES, Recognition, Row
from estimator.commands.common.console import note, print_table


def show(result: Recognition) -> None:
    """One table an experiment."""
    looks = (f"{k} pair{'s' * (k > 1)}" for k in range(1, result.pairs + 1))
    header = ("roofs", "method", *looks, "wrong", "wrong <", "ms", "p99", "m")
    for experiment in dict.fromkeys(r.experiment for r in result.rows):
        rows = [_cells(r) for r in result.rows if r.experiment == experiment]
        print_table(f"\n{TITLES[experiment]}: {result.samples} samples each", rows, header)
    note("pairs: recognised with so many at most; wrong <: upper 95 % bound of the share of wrong answers; ms: one core, a pair")
    note(f"key points of an image: median {result.key_points_p50:.0f}, least {result.key_points_least}")


def _cells(row: Row) -> list[str | Text]:
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
