"""SQL over the rows: duckdb on Parquet, tables `rows` and the user's `joined`."""

from pathlib import Path
from typing import Any, NamedTuple

import duckdb
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from estimator.tools.fleet.errors import FleetError


class Answer(NamedTuple):
    """Names of the columns, and the rows."""

    columns: tuple[str, ...]
    rows: list[tuple[Any, ...]]


def ask(rows: pa.Table, sql: str, joined: pa.Table | None = None) -> Answer:
    """Result of the query. Raises FleetError."""
    with duckdb.connect(config={"enable_external_access": "false", "python_enable_replacements": "false"}) as connection:
        connection.register("rows", rows)
        if joined is not None:
            connection.register("joined", joined)
        try:
            found = connection.sql(sql)
            if found is None:
                raise FleetError("--sql: selects nothing")
            return Answer(tuple(found.columns), found.fetchall())
        except duckdb.Error as error:
            raise FleetError(f"--sql: {str(error).splitlines()[0]}") from None


def with_columns(rows: pa.Table, file: Path | None) -> pa.Table:
    """Rows with columns of a CSV or Parquet file by its column log. Raises FleetError."""
    if file is None:
        return rows
    try:
        table = pq.read_table(file) if file.suffix == ".parquet" else pa_csv.read_csv(file)
    except (OSError, pa.ArrowException) as error:
        raise FleetError(f"{file}: cannot be read ({' '.join(str(error).split())[:100]})") from None
    if "log" not in table.column_names:
        raise FleetError(f"{file}: has no column log; there are {', '.join(table.column_names)}")
    table = table.drop_columns([name for name in table.column_names if name in rows.column_names and name != "log"])
    by_log = {str(log): k for k, log in reversed(list(enumerate(table.column("log").to_pylist())))}
    lines = [_line(log, by_log) for log in rows.column("log").to_pylist()]
    if not any(line is not None for line in lines):
        raise FleetError(f"{file}: none of its logs has a row")
    for name in table.column_names:
        if name != "log":
            rows = rows.append_column(name, table.column(name).take(pa.array(lines, pa.int64())))
    return rows


def _line(log: str, by_log: dict[str, int]) -> int | None:
    parts = log.split("/")
    return next((by_log[end] for k in range(len(parts)) if (end := "/".join(parts[k:])) in by_log), None)
