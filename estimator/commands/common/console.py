"""Results on stdout, progress and remarks on stderr."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import typer

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.text import Text

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
Out = Annotated[Path, typer.Option("--out", "-o", help="File to write.")]
ConfigFile = Annotated[
    Path | None, typer.Option("--config", "-c", help="TOML configuration (landfix doctor --config --all lists all keys).")
]

Jobs = Annotated[int | None, typer.Option(metavar="N", min=1, help="Processes [default: one per core].")]
Scheduler = Annotated[
    str, typer.Option(metavar="ADDRESS", help="dask.distributed scheduler, such as tcp://10.0.0.5:8786; default: this machine.")
]

_INTERRUPTED = 130  # the shell's exit code for SIGINT
_NOTHING_KEPT = "landfix: interrupted; nothing was written"


class Reported(Protocol):
    """Callback of a progress bar."""

    def __call__(self, fraction: float, now: str = "") -> None:
        """Fraction done, current step."""


@contextmanager
def progress(title: str) -> Iterator[Reported]:
    """A bar on stderr; yields a function of fraction and step."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(), TimeElapsedColumn()
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(title, total=1.0)
        yield lambda fraction, now="": bar.update(task, completed=fraction, description=f"{title} {now}".rstrip())


@contextmanager
def kept_on_interrupt(outputs: "Callable[[], Sequence[Path]]") -> Iterator[None]:
    """On Ctrl-C, name the written files; exit code 130."""
    before = {path: _stat(path) for path in outputs()}
    try:
        yield
    except KeyboardInterrupt:
        kept = [path for path in outputs() if _stat(path) not in {None, before.get(path)}]
        sizes = ", ".join(
            f"{path} ({path.stat().st_size / 1e6:.1f} MB)" for path in sorted(kept, key=lambda p: p.stat().st_mtime_ns)
        )
        note(f"landfix: interrupted; kept: {sizes}; the last one ends where it was interrupted" if kept else _NOTHING_KEPT)
        raise typer.Exit(_INTERRUPTED) from None


def _stat(path: Path) -> tuple[int, int] | None:
    try:
        stat = path.stat()
    except OSError:
        return None
    return stat.st_mtime_ns, stat.st_size


def print_json(value: Any) -> None:
    """One JSON object; infinities and NaN become null."""
    import msgspec

    typer.echo(msgspec.json.format(msgspec.json.encode(value)).decode())


def print_table(title: str, rows: "Sequence[Sequence[str | Text]]", header: Sequence[str] = ()) -> None:
    """Rows under a title."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), title_justify="left", title_style="bold", show_header=bool(header), box=None, pad_edge=False)
    for name in header or [""] * max((len(r) for r in rows), default=1):
        table.add_column(Text(name), overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in row))
    Console().print(table)


def note(text: str) -> None:
    """A remark on stderr."""
    typer.echo(text, err=True)
