"""Benchmarks, which are part of the repository and not of the package."""

from importlib import import_module
from typing import Any


class CloneError(ValueError):
    """The package is installed without its repository; one line."""


def of_clone(name: str, command: str) -> Any:
    """The module benchmarks.`name`, for a command. Raises CloneError."""
    try:
        return import_module(f"benchmarks.{name}")
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "benchmarks":
            raise
        raise CloneError(
            f"{command} needs a clone of the repository: its benchmarks and tests are not part of the package"
        ) from None
