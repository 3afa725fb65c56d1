"""What a map holds, as columns, and what was found while reading it."""

import re
from collections import Counter
from collections.abc import Iterable

import msgspec
import numpy as np
from numpy.typing import NDArray

from models.messages import Array

Weights = tuple[float, float, float, float]
WEIGHTS: Weights = (0.20966, 0.30413, 0.302214, 0.209658)  # size, width, length, fill ratio (thesis eq. 5.5; their sum is 1.0257)


class Columns(msgspec.Struct, frozen=True, eq=False):
    """N landmarks: vertices (V, 2) north, east, offsets (N + 1,).

    base_d: down of the ground; colour_bgr (N, 3), -1: unknown; weights, names: own ones.
    """

    ids: list[str]
    vertices: Array
    offsets: NDArray[np.int64]
    base_d: Array
    height_m: Array
    colour_bgr: NDArray[np.int16]
    sigma_m: Array
    height_sigma_m: Array
    outline_sigma_m: Array
    corner_sigma_m: Array
    weights: dict[int, Weights]
    names: dict[int, str]


class Alike(msgspec.Struct, frozen=True, eq=False):
    """Per landmark: similar ones (N,), nearest [m], nearest repeating shift [m]; inf: none."""

    count: NDArray[np.int64]
    nearest_m: Array
    repeats_m: Array


class Finding(msgspec.Struct, frozen=True):
    """Something about one feature (1 = the first in the file)."""

    feature: int
    id: str
    text: str

    def __str__(self) -> str:
        return f"feature {self.feature} ({self.id}): {self.text}"


class MapReport(msgspec.Struct, frozen=True, eq=False):
    """Rejected features, remarks, defaults by property; doubt: about the whole file, or ""."""

    features: int = 0
    rejected: tuple[Finding, ...] = ()
    remarks: tuple[Finding, ...] = ()
    missing: dict[str, int] = {}
    doubt: str = ""


def reasons(findings: Iterable[Finding]) -> list[tuple[str, int]]:
    """Findings with numbers of features."""
    return Counter(re.sub(r"#?\d[\d.]*", "...", finding.text) for finding in findings).most_common()


class MapError(ValueError):
    """The file is no map; one line with the remedy."""


class Defaults(msgspec.Struct, frozen=True):
    """Roof height and horizontal sigma of features without; the map's origin and common shift."""

    height_m: float = 6.0
    sigma_m: float = 0.5
    origin: tuple[float, float, float] | None = None
    common_sigma_m: tuple[float, float] | None = None
