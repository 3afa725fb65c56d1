"""A row a flight; fields are the Parquet columns, null without a value."""

import math
from typing import Any, Final

import msgspec
import numpy as np

from logs.evaluation.evaluate import ALL_SOURCES
from logs.evaluation.integrity import Regions
from logs.evaluation.records import AidSummary, Evaluation
from models.messages import Reason

COSTS: Final = frozenset({"cpu_s", "wall_s", "memory_mb", "read_bytes"})  # differ between equal runs


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One flight under one label.

    key: of inputs, configuration, program, options; nis, refused: by "topic kind" and reason; *_exceeded: errors above the level;
    available: share within alert limits; outage_end_m: RMS.
    """

    key: str
    label: str
    log: str
    parts: int
    stored_bytes: int
    inputs_sha256: str = ""
    configuration_sha256: str = ""
    version: str = ""
    code: str = ""
    from_images: bool = False
    error: str = ""
    vehicle: str = ""
    imported_as: str = ""
    start_utc_s: float | None = None
    lat_deg: float | None = None
    lon_deg: float | None = None
    duration_s: float | None = None
    distance_m: float | None = None
    first_estimate_s: float | None = None
    reference: str = ""
    compared: int = 0
    rmse_m: float | None = None
    max_m: float | None = None
    horizontal_m: float | None = None
    vertical_m: float | None = None
    aided_m: float | None = None
    attitude_deg: float | None = None
    velocity_m_s: float | None = None
    nees_position: float | None = None
    nees_attitude: float | None = None
    nees_pose: float | None = None
    covered95: float | None = None
    radius95_median_m: float | None = None
    radius95_max_m: float | None = None
    nis_per_dof: float | None = None
    nis: dict[str, float] = {}
    outages: int = 0
    longest_outage_s: float | None = None
    without_absolute_s: float | None = None
    outage_end_m: float | None = None
    resets: int = 0
    internal_errors: int = 0
    measurements: int = 0
    fused: int = 0
    refused: dict[str, int] = {}
    modes: dict[str, float] = {}
    levels: int = 0
    hpl_median_m: float | None = None
    vpl_median_m: float | None = None
    hpl_exceeded: int | None = None
    vpl_exceeded: int | None = None
    misleading: int | None = None
    hazardous: int | None = None
    available: float | None = None
    torn: bool = False
    skipped_chunks: int = 0
    missing: str = ""
    cpu_s: float = 0.0
    wall_s: float = 0.0
    memory_mb: float = 0.0
    read_bytes: int = 0


def of_evaluation(evaluation: Evaluation) -> dict[str, Any]:
    """Columns of an evaluation."""
    found: dict[str, Any] = {
        "duration_s": evaluation.duration_s,
        "distance_m": evaluation.distance_m,
        "reference": evaluation.compared_with if evaluation.compared else "",
        "compared": evaluation.compared,
        "outages": sum(o.source == ALL_SOURCES for o in evaluation.outages),
        "longest_outage_s": max((o.duration_s for o in evaluation.outages if o.source == ALL_SOURCES), default=0.0),
        "without_absolute_s": evaluation.without_absolute_s,
        "outage_end_m": _rms([o.drift.end_m for o in evaluation.outages if o.drift and o.source == ALL_SOURCES]),
        "resets": len(evaluation.resets),
        "modes": evaluation.modes,
        **_errors(evaluation),
        **_measurements(evaluation.aids),
        **_levels(evaluation),
    }
    return {name: None if isinstance(value, float) and not math.isfinite(value) else value for name, value in found.items()}


def _errors(evaluation: Evaluation) -> dict[str, float]:
    accuracy, consistency = evaluation.accuracy, evaluation.consistency
    if accuracy is None or consistency is None:
        return {}
    return {
        "rmse_m": accuracy.position_m.rmse,
        "max_m": accuracy.position_m.max,
        "horizontal_m": accuracy.horizontal_m.rmse,
        "vertical_m": accuracy.vertical_m.rmse,
        "aided_m": accuracy.aided_position_m.rmse,
        "attitude_deg": accuracy.attitude_deg.rmse,
        "velocity_m_s": accuracy.velocity_m_s.rmse,
        "nees_position": consistency.position.mean,
        "nees_attitude": consistency.attitude.mean,
        "nees_pose": consistency.pose.mean,
        "covered95": consistency.radius95_covered,
        "radius95_median_m": consistency.radius95_median_m,
        "radius95_max_m": consistency.radius95_max_m,
    }


def _measurements(aids: tuple[AidSummary, ...]) -> dict[str, Any]:
    refused: dict[str, int] = {}
    for aid in aids:
        for reason, n in aid.reasons.items():
            if reason not in {Reason.FUSED.value, Reason.ALIGNING.value}:
                refused[reason] = refused.get(reason, 0) + n
    fused = {f"{aid.topic} {aid.kind}": aid.reasons.get(Reason.FUSED.value, 0) for aid in aids}
    nis = {f"{aid.topic} {aid.kind}": aid.nis for aid in aids if aid.nis is not None and math.isfinite(aid.nis)}
    weights = sum(fused[name] for name in nis)
    return {
        "nis": nis,
        "nis_per_dof": math.fsum(fused[name] * x for name, x in nis.items()) / weights if weights else None,
        "measurements": sum(n for aid in aids for n in aid.reasons.values()),
        "fused": sum(fused.values()),
        "refused": dict(sorted(refused.items())),
    }


def _levels(evaluation: Evaluation) -> dict[str, Any]:
    integrity = evaluation.integrity
    if integrity is None:
        return {}
    both = integrity.horizontal, integrity.vertical
    limits = any(limit is not None for limit in integrity.limits_m)
    found: dict[str, Any] = {"levels": integrity.evaluations}
    for name, regions in zip(("hpl", "vpl"), both, strict=True):
        if regions is not None:
            found |= {f"{name}_median_m": regions.median_level_m, f"{name}_exceeded": regions.exceeded[-1]}
    judged = [r for r in both if isinstance(r, Regions)]
    if limits and judged:
        found |= {
            "misleading": sum(r.misleading for r in judged),
            "hazardous": sum(r.hazardous for r in judged),
            "available": min(r.available for r in judged),
        }
    return found


def _rms(values: list[float]) -> float | None:
    return float(np.sqrt(np.mean(np.square(values)))) if values else None
