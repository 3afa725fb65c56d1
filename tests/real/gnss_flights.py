"""Recorded flights with GNSS, as imported, through the estimator."""

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.integrity.runs import outputs_of
from estimator.config import Config, load
from estimator.fusion import Fusion
from logs.evaluation.metrics import Times
from logs.importers import csv_folder
from logs.importers.recording import Recording, Truth
from models.messages import AidStatus, Array, Input
from models.state import E, X

THOR75, GLITCH = "umn_thor75", "inertialnav_logs/f450_glitch"
GLITCH_S = 116.0  # from here on the receiver of GLITCH is wrong


class Track(msgspec.Struct, frozen=True):
    """Estimates as arrays: t_ns (n,), p_n (n, 3), covariance of position (n, 3, 3)."""

    t_ns: Times
    p_n: Array
    covariance: Array


def flight(data: Path, folder: str, out: Path) -> tuple[Recording, Config]:
    """A flight as imported, and the configuration that the importer writes next to it."""
    source = data / "flights" / folder
    recording = csv_folder.read(source)
    path = out / f"{source.name}.toml"
    path.write_text(recording.settings.toml("csv", source, tuple(s.topic for s in recording.streams)))
    return recording, load(path)


def run(messages: Sequence[Input], config: Config) -> tuple[Track, list[AidStatus]]:
    """Everything through Fusion.handle; the first estimate of each stamp counts."""
    estimates, others = outputs_of(Fusion(config.fusion()), messages)
    track = [estimates[t] for t in sorted(estimates)]
    return Track(
        np.array([e.t_ns for e in track], np.int64),
        np.array([e.nav[X.P] for e in track]).reshape(-1, 3),
        np.array([e.covariance[E.P, E.P] for e in track]).reshape(-1, 3, 3),
    ), [output for output in others if isinstance(output, AidStatus)]


def inputs(recording: Recording) -> list[Input]:
    """What the estimator may see, in the order of arrival."""
    return [m for m in recording if not isinstance(m, Truth)]
