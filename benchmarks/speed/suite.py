"""What each test costs: seconds of the processor, of its fixtures and of the processes that it starts and waits for.

python -m pytest -n 2 -p benchmarks.speed.suite [TESTS]

A plugin of pytest. Writes out/tests.csv (file, tests, seconds; the dearest first) and prints the dearest tests and
the sums of the folders. A fixture counts for the test that asks for it first.
"""

import csv
import resource
from collections import Counter, defaultdict
from collections.abc import Generator
from pathlib import Path
from typing import Final

import pytest

_REPORT: Final = Path(__file__).parents[2] / "out/tests.csv"
_NAME, _SHOWN = "cpu_s", 40

spent, count = defaultdict[str, float](float), Counter[str]()


def _cpu_s() -> float:
    """Of this process and of those of its children that have ended."""
    both = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(used.ru_utime + used.ru_stime for used in both)


def _timed(item: pytest.Item) -> Generator[None, object, object]:
    start = _cpu_s()
    try:
        return (yield)
    finally:
        item.user_properties.append((_NAME, _cpu_s() - start))  # a worker sends it with the report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None, object, object]:
    """The fixtures."""
    return (yield from _timed(item))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """The test."""
    return (yield from _timed(item))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item) -> Generator[None, object, object]:
    """What ends the fixtures."""
    return (yield from _timed(item))


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """The last report of a test has all that it has spent."""
    if report.when == "teardown":
        spent[report.nodeid] += sum(float(str(value)) for name, value in report.user_properties if name == _NAME)
        count[_file(report.nodeid)] += 1


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """The dearest tests, the folders, and the file of both."""
    terminalreporter.section(f"{sum(spent.values()):.0f} s of the processor")
    for test, seconds in _dearest(spent)[:_SHOWN]:
        terminalreporter.write_line(f"{seconds:8.2f} s  {test}")
    files, folders = defaultdict[str, float](float), defaultdict[str, float](float)
    for test, seconds in spent.items():
        files[_file(test)] += seconds
        folders[str(Path(_file(test)).parent)] += seconds
    for folder, seconds in _dearest(folders):
        terminalreporter.write_line(f"{seconds:8.2f} s  {folder}")
    _REPORT.parent.mkdir(exist_ok=True)
    with _REPORT.open("w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(["file", "tests", "cpu_s"])
        writer.writerows([file, count[file], f"{seconds:.2f}"] for file, seconds in _dearest(files))


def _dearest(sums: dict[str, float]) -> list[tuple[str, float]]:
    return sorted(sums.items(), key=lambda item: -item[1])


def _file(test: str) -> str:
    return test.partition("::")[0]
