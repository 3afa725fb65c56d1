"""Tests of `make test-long`: campaigns in small, many cases of one kind. `make test` leaves them out (pyproject.toml)."""

from collections.abc import Callable, Iterable
from typing import Any

import pytest

Ids = Iterable[str] | Callable[[Any], str] | None


def parametrize(names: str | tuple[str, ...], values: Iterable[Any], one_in: int = 1000, ids: Ids = None) -> pytest.MarkDecorator:
    """parametrize: the first of each one_in values is for `make test`, the others are for `make test-long`."""
    several = not isinstance(names, str)
    some = [
        pytest.param(*(value if several else [value]), marks=[pytest.mark.long] if k % one_in else [])
        for k, value in enumerate(values)
    ]
    return pytest.mark.parametrize(names, some, ids=ids)
