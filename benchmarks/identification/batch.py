"""A batch of looks or pairs of one world, and what is counted of it."""

import math
from hashlib import sha256
from itertools import chain
from typing import Final, TypeAlias

import msgspec
import numpy as np

from benchmarks.flights.tasks import ROOT
from models.messages import Array
from vision.records.reports import INSIDE_9999

Job: TypeAlias = tuple[str, str, float, int, int, str]  # kind, layout, prior [m], how many, seed, program

OFF_M: Final = 3.0
SURER: Final = 1e-5
_FILES: Final = ("batch", "images", "looks", "worlds")


class Case(msgspec.Struct, frozen=True):
    """A fix. number: in its batch; chi2: of the position; far: a wrong one; doubt: claimed probability of a wrong identity."""

    number: int
    error_m: float
    chi2: float
    far: bool
    identified: int
    mistaken: tuple[str, ...]
    doubt: float = 0.0


class Batch(msgspec.Struct, frozen=True):
    """Of `tried` looks or pairs. far: fixes off by more than 3 m and outside their 99.99 % ellipsoid; misled: those with a wrong
    identity; identified, mistaken: identities of the fixes, and the wrong ones; doubt: sum over the fixes of looks; surer: those
    with a tenth of what is allowed.
    """

    kind: str
    world: str
    seed: int
    program: str
    tried: int
    fixes: int = 0
    far: int = 0
    misled: int = 0
    identified: int = 0
    mistaken: int = 0
    doubt: float = 0.0
    surer: int = 0
    cases: tuple[Case, ...] = ()


def counted(job: Job, fixes: list[Case]) -> Batch:
    """fixes: each of them, right ones too."""
    kind, layout, prior_m, tried, seed, made_by = job
    far = [c for c in fixes if c.far]
    identities = sum(c.identified for c in fixes), sum(len(c.mistaken) for c in fixes)
    doubts = math.fsum(c.doubt for c in fixes), sum(c.doubt < SURER for c in fixes)
    cases = tuple(c for c in fixes if c.far or c.mistaken)
    misled = sum(bool(c.mistaken) for c in far)
    world = f"{layout}, prior {prior_m:g} m"
    return Batch(kind, world, seed, made_by, tried, len(fixes), len(far), misled, *identities, *doubts, cases)


def case_of(number: int, error: Array, covariance: Array, identified: int, mistaken: tuple[str, ...], doubt: float = 0.0) -> Case:
    """error (3,), covariance (3, 3): of the fix's position."""
    error_m, chi2 = float(np.linalg.norm(error)), float(error @ np.linalg.solve(covariance, error))
    return Case(number, error_m, chi2, error_m > OFF_M and chi2 > INSIDE_9999[2], identified, mistaken, doubt)


def program() -> str:
    """sha256 of vision, models, and what draws the worlds: of nothing else are the counts."""
    ours = [ROOT / "benchmarks" / "identification" / f"{name}.py" for name in _FILES]
    files = chain(sorted((ROOT / "vision").rglob("*.py")), sorted((ROOT / "models").rglob("*.py")), ours)
    return sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]
