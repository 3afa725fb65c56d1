"""Tests of `make test-long`: campaigns in small, many cases of one kind. `make test` leaves them out (pyproject.toml)."""

from collections.abc import Callable, Iterable
from typing import Any

import pytest

Ids = Iterable[str] | Callable[[Any], str] | None


def some(values: Iterable[Any], one_in: int = 1000, *, several: bool = False) -> list[Any]:
    """The first of each one_in values is for `make test`, the others for `make test-long`. several: each is a tuple of values."""
    return [
        pytest.param(*(value if several else [value]), marks=[pytest.mark.long] if k % one_in else [])
        for k, value in enumerate(values)
    ]


def parametrize(names: str | tuple[str, ...], values: Iterable[Any], one_in: int = 1000, ids: Ids = None) -> pytest.MarkDecorator:
    """parametrize, by some of the values."""
    return pytest.mark.parametrize(names, some(values, one_in, several=not isinstance(names, str)), ids=ids)
