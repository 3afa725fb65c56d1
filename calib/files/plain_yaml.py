"""YAML to plain values, and back."""

from collections.abc import Iterable
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from calib.errors import CalibrationError
from models.messages import Array


def parse(text: str, where: str) -> dict[str, Any]:
    """The mapping of a YAML text. Raises CalibrationError."""
    try:
        value = YAML(typ="safe", pure=True).load(text)
    except YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark is not None else ""
        raise CalibrationError(f"{where}: no valid YAML{line}: {getattr(error, 'problem', None) or 'cannot be read'}") from None
    except RecursionError:
        raise CalibrationError(f"{where}: no valid YAML: it is nested too deeply") from None
    if not isinstance(value, dict):
        raise CalibrationError(f"{where}: expected a YAML mapping of names to values")
    return value


def number(x: float) -> str:
    """Shortest float64 text, for YAML 1.1."""
    text = repr(float(x))
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def sequence(values: Iterable[float]) -> str:
    """[a, b, c]."""
    return "[" + ", ".join(number(x) for x in values) + "]"


def rows(matrix: Array, indent: str) -> str:
    """A matrix as a list of rows, one line each."""
    return "".join(f"\n{indent}- {sequence(row)}" for row in matrix)
