"""Kernels are compiled before they are needed, and compiled anew where a source has changed."""

import subprocess
import sys
from pathlib import Path

import pytest

from estimator.service.base import compilation
from estimator.tools import kernels
from tests.estimator.service.flying import environment

_STALE = """
import numpy as np
from estimator.service.base import compilation
from models import so3
assert not compilation.is_current()
so3.multiply(np.zeros(4), np.zeros(4))
compilation.mark_current()
assert compilation.is_current()
digest = compilation._digest
compilation._digest = lambda: digest() + "after a change"
assert not compilation.is_current()
compilation.forget()
compilation.mark_current()
assert not compilation.is_current()  # nothing is there
"""


def compiles_one() -> None:
    import numba  # noqa: PLC0415

    numba.njit(lambda x: x + 1)(1)


def cannot() -> None:
    raise SystemExit(3)


@pytest.mark.long
def test_what_was_compiled_of_other_sources_is_forgotten(tmp_path: Path) -> None:
    said = {**environment(), "NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", _STALE], env=said, check=True)
    assert list(tmp_path.rglob("landfix.kernels"))
    assert not list(tmp_path.rglob("*.nb[ic]"))


def test_every_file_that_may_go_into_a_kernel_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    before, sources = compilation._digest(), compilation._sources()
    for name in (
        "models/state.py",
        "vision/outline/visibility.py",
        "vision/synthetic/faces.py",
        "estimator/sources/pose.py",
        "logs/wire/cdr_fast.py",
    ):
        without = [path for path in sources if not path.as_posix().endswith(name)]
        assert len(without) == len(sources) - 1
        monkeypatch.setattr(compilation, "_sources", lambda left=without: left)
        assert compilation._digest() != before


@pytest.fixture
def nothing_there(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Nothing is compiled, as far as prepare() knows; what it says is done."""
    done: list[str] = []
    monkeypatch.setattr(compilation, "is_current", lambda: False)
    monkeypatch.setattr(compilation, "forget", lambda: done.append("forgotten"))
    monkeypatch.setattr(compilation, "mark_current", lambda: done.append("marked"))
    return done


def test_what_is_compiled_is_named_and_then_marked(nothing_there: list[str]) -> None:
    heard: list[tuple[float, str]] = []
    kernels.prepare(lambda share, now: heard.append((share, now)), [compiles_one, compiles_one])
    assert any("test_kernels" in now for _, now in heard)
    assert heard[-1] == (2 / kernels._SIGNATURES, "")
    assert nothing_there == ["forgotten", "marked"]


def test_a_part_that_fails_is_said_and_not_marked(nothing_there: list[str]) -> None:
    with pytest.raises(kernels.KernelsError, match="ended with 3"):
        kernels.prepare(parts=[cannot])
    assert nothing_there == ["forgotten"]


@pytest.mark.long
def test_parts_run_two_at_a_time_and_progress_is_a_line_a_tenth(
    nothing_there: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    kernels.prepare(kernels.each_tenth("compiling"), [compiles_one] * 3)
    assert nothing_there == ["forgotten", "marked"]
    (first,) = capfd.readouterr().err.splitlines()  # 3 of 128 are no tenth
    assert first.startswith("compiling   ")


def test_where_all_is_current_nothing_is_done(nothing_there: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compilation, "is_current", lambda: True)
    kernels.prepare(parts=[cannot])
    assert nothing_there == []
