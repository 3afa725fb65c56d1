"""One case through the estimator: error, consistency, and what was reported."""

from collections import Counter
from typing import Final

import msgspec
import numpy as np

from benchmarks.faults.cases import CASES, Case
from benchmarks.flights.tasks import INSIDE95
from estimator.fusion import Fusion
from models.messages import AidStatus, Array, Estimate, Health, Mode, Reason
from models.sim.scenario import EPOCH_NS, Truth
from models.state import E, X, local

OVERCONFIDENT: Final = 3.0  # times the 95 % radius
_EVERY: Final = 10
_SECOND_NS: Final = 1_000_000_000
_HARMLESS: Final = {Reason.FUSED, Reason.THINNED, Reason.ALIGNING}
_PARTS: Final = {"position": E.P, "velocity": E.V, "attitude": E.THETA}


class Score(msgspec.Struct, frozen=True):
    """Since the fault. lit_m: rms while there is GNSS; end_m: at the end of the dark; overconfident: shares by part.

    nees: NEES/3 of position; published: share of the time with an estimate; refused: share of the sensor's readings, by reason;
    said: what health said of it, longest first.
    """

    sensor: str
    fault: str
    seed: int
    lit_m: float
    end_m: float
    overconfident: dict[str, float]
    nees: float
    published: float
    refused: dict[str, float]
    details: dict[str, float]
    said: dict[str, float]
    internal: int


def run(job: tuple[str, str, int]) -> Score:
    """Sensor, fault, seed."""
    sensor, fault, seed = job
    case = CASES[sensor][fault](seed)
    fusion = Fusion(case.config)
    estimates, health = list[Estimate](), list[Health]()
    decided: dict[tuple[str, str, int], AidStatus] = {}
    for message in case.messages:
        for out in fusion.handle(message):
            match out:
                case Estimate():
                    estimates.append(out)
                case Health():
                    health.append(out)
                case AidStatus():
                    decided[out.topic, out.kind, out.t_ns] = out
    return _scored(job, case, estimates, health, list(decided.values()))


def _scored(
    job: tuple[str, str, int], case: Case, estimates: list[Estimate], health: list[Health], words: list[AidStatus]
) -> Score:
    begin_ns, dark_ns, end_ns = (EPOCH_NS + round(s * _SECOND_NS) for s in (case.begin_s, case.dark_s, case.end_s))
    since = [e for e in estimates if begin_ns <= e.t_ns < end_ns]
    some = since[::_EVERY]
    off = np.array([_error(e, case.truth) for e in some]).reshape(-1, E.SIZE)
    cov = np.array([e.covariance for e in some]).reshape(-1, E.SIZE, E.SIZE)
    t_ns = np.array([e.t_ns for e in some], np.int64)
    aligned = np.array([e.mode is not Mode.ALIGNING_HEADING for e in some], bool)
    size = np.linalg.norm(off[:, E.P], axis=1)
    over = {}
    for name, part in _PARTS.items():
        radius = np.sqrt(INSIDE95 * np.clip(np.linalg.eigvalsh(cov[:, part, part])[:, -1], 0.0, None))
        beyond = np.linalg.norm(off[:, part], axis=1) > OVERCONFIDENT * radius
        counts = aligned | (name != "attitude")
        over[name] = float(np.mean(beyond[counts])) if counts.any() else 0.0
    nees = np.einsum("ki,ki->k", off[:, E.P], np.linalg.solve(cov[:, E.P, E.P], off[:, E.P, np.newaxis])[:, :, 0]) / 3.0
    lit = t_ns < dark_ns
    due = int(np.sum((case.truth.t_ns >= begin_ns) & (case.truth.t_ns < end_ns)))
    readings = [s for s in words if s.topic in case.topics and s.t_ns >= begin_ns and s.kind != "imu"]
    refused = Counter(str(s.reason) for s in readings if s.reason not in _HARMLESS)
    details = Counter(s.detail for s in readings if s.detail and s.reason not in _HARMLESS)
    said = Counter(part for h in health if h.t_ns >= begin_ns for part in h.detail.split("; ") if part)
    states = Counter(
        f"{topic} {h.sources[topic]}" for h in health if h.t_ns >= begin_ns for topic in case.topics if topic in h.sources
    )
    count, ticks = max(len(readings), 1), max(sum(h.t_ns >= begin_ns for h in health), 1)
    return Score(
        *job,
        lit_m=float(np.sqrt(np.mean(size[lit] ** 2))) if lit.any() else float("nan"),
        end_m=float(size[-1]) if len(size) else float("nan"),
        overconfident=over,
        nees=float(nees.mean()) if len(nees) else float("nan"),
        published=len(since) / max(due, 1),
        refused={reason: n / count for reason, n in refused.most_common(4)},
        details={text: n / count for text, n in details.most_common(4)},
        said={text: n / ticks for text, n in [*said.most_common(5), *states.most_common(4)]},
        internal=sum(s.reason is Reason.INTERNAL for s in words),
    )


def _error(e: Estimate, truth: Truth) -> Array:
    k = min(int(np.searchsorted(truth.t_ns, e.t_ns)), len(truth.t_ns) - 1)
    x = np.empty(X.SIZE)
    x[X.P], x[X.V], x[X.Q] = truth.p_n[k], truth.v_n[k], truth.q_nb_wxyz[k]
    x[X.BG], x[X.BA] = truth.gyro_bias[k], truth.accel_bias[k]
    return local(e.nav, x)
