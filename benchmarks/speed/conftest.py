"""Prints the table of speeds when the benchmarks are done."""

import pytest

from benchmarks.speed import table as speed_table


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if speed_table.RESULTS:
        terminalreporter.section("speed, with the plain filter of benchmarks/flights/naive_filter.py")
        terminalreporter.write_line(speed_table.text())
