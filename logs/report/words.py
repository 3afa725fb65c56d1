"""The flight in words: kind, verdict, reasons."""

from collections.abc import Iterable
from enum import IntEnum
from typing import Final, NamedTuple

import msgspec
import numpy as np

from logs.evaluation.collected import Collected
from logs.evaluation.metrics import Consistency
from logs.evaluation.records import AidSummary, Evaluation
from logs.findings import Finding as Cause
from logs.findings import together
from logs.report.gather import Gathered
from logs.store.reader import Attachment
from logs.store.recorder import FINDINGS_ATTACHMENT
from models.messages import Mode, Reason
from models.radius import horizontal_radius
from models.untrusted.toml_text import one_line
from models.web_page import BAD, GOOD, USABLE

_MANY_REFUSED: Final = 0.2
_NIS_BAND: Final = (0.3, 2.0)  # of the mean over a flight; outside, sigmas are wrong by more than 1.4 or 1.8
_LATE_S: Final = 0.15  # what an autopilot still takes for an estimate of now
_FEW: Final = 20
_JUMP_M: Final = 1.0
_NOT_JUDGED: Final = {Reason.ALIGNING, Reason.THINNED, Reason.DUPLICATE, Reason.PROBATION, Reason.NO_FIX}


class Level(IntEnum):
    """Severity of a finding; the flight's is its worst."""

    FINE = 0
    WARNING = 1
    WRONG = 2

    @property
    def colour(self) -> str:
        """Class of the page."""
        return (GOOD, USABLE, BAD)[self]

    @property
    def word(self) -> str:
        """Verdict in a word."""
        return ("no problems found", "warnings", "do not rely on this estimate")[self]


class Finding(NamedTuple):
    """One reason."""

    level: Level
    text: str


def summary(e: Evaluation, gathered: Gathered) -> str:
    """Two or three sentences."""
    modes = ", ".join(f"{share:.0%} {mode.replace('_', ' ')}" for mode, share in sorted(e.modes.items(), key=lambda m: -m[1]))
    outages = sum(o.source == "all" for o in e.outages)
    words = [f"The estimate covers {duration(e.duration_s)} and {e.distance_m:.0f} m ({gathered.estimates} estimates)."]
    if modes:
        words.append(f"Mode: {modes}.")
    if outages:
        longest = max(o.duration_s for o in e.outages if o.source == "all")
        several = f"{outages} times, {duration(e.without_absolute_s)} in all, {longest:.1f} s at the longest"
        words.append(f"It was without an absolute fix {several if outages > 1 else f'once, for {duration(longest)}'}.")
    elif e.aids or e.modes:
        words.append("It was never without absolute fixes for long.")
    if e.accuracy:
        a = e.accuracy
        p, what = a.position_m, "position error" if e.compared_with == "truth" else "difference in position"
        errors = f"Against the {e.compared_with} the {what} was {p.rmse:.2f} m (RMS), {p.max:.2f} m at most"
        aided = f"; {a.aided_position_m.rmse:.2f} m outside outages" if outages and a.aided_position_m.n else ""
        attitude = f"; attitude {a.attitude_deg.rmse:.2f}° RMS" if a.attitude_deg.n else ""
        words.append(f"{errors}{aided}{attitude}.")
    else:
        words.append(
            "There is no ground truth in the log, so errors are unknown. The figures below are those the estimator reports."
        )
    return " ".join(words)


def duration(s: float) -> str:
    """As a person says it."""
    return f"{s:.1f} s" if s < 120.0 else f"{s / 60.0:.1f} min" if s < 7200.0 else f"{s / 3600.0:.1f} h"


def findings(e: Evaluation, collected: Collected, gathered: Gathered) -> list[Finding]:
    """Faulty streams, then worst first."""
    found = [
        *_consistency(e),
        *_behaviour(e, gathered),
        *_jumps(collected),
        *(f for aid in e.aids for f in _source(aid)),
        *_vision(gathered),
        *_log(e, collected, gathered),
    ]
    return [*at_fault(collected.attachments), *sorted(found, key=lambda f: -f.level)]


def at_fault(attachments: Iterable[Attachment]) -> list[Finding]:
    """Faulty streams found by a replay."""
    data = next((a.data for a in attachments if a.name == FINDINGS_ATTACHMENT), b"[]")
    try:
        causes = msgspec.json.decode(data, type=list[Cause])
    except msgspec.DecodeError:
        return []
    return [Finding(Level.WRONG if c.unfit else Level.WARNING, f"at fault: {one_line(str(c))}") for c in together(causes)]


def _consistency(e: Evaluation) -> list[Finding]:
    if e.consistency is None:
        return []
    covered = e.consistency.radius95_covered
    level = Level.FINE if covered >= 0.9 else Level.WARNING if covered >= 0.75 else Level.WRONG
    what = "error" if e.compared_with == "truth" else "difference from the reference"
    found = [Finding(level, f"the {what} was inside the reported 95 % radius {covered:.0%} of the time")]
    of = e.consistency
    for name, c in (("position", of.position), ("attitude", of.attitude), ("velocity", of.velocity)):
        found += _overconfident(name, c)
    # The reference may be what is wrong: no verdict rests on it alone
    return found if e.compared_with == "truth" else [Finding(min(f.level, Level.WARNING), f.text) for f in found]


def _overconfident(name: str, c: Consistency) -> list[Finding]:
    if not c.n or np.isnan(c.mean) or c.mean <= max(c.band[1], 1.3):
        return []
    if np.isinf(c.mean):
        return [Finding(Level.WRONG, f"{name} covariances are at times not positive definite: they report no bound there")]
    level = Level.WRONG if c.mean > max(4.0, 2.0 * c.band[1]) else Level.WARNING
    return [
        Finding(
            level,
            f"{name} errors are {np.sqrt(c.mean):.2g} times the reported 1-sigma (NEES {c.mean:.2g} per degree of freedom)",
        )
    ]


def _behaviour(e: Evaluation, gathered: Gathered) -> list[Finding]:
    found = []
    if (coasting := e.modes.get(Mode.COASTING, 0.0)) > 0.0:
        found.append(
            Finding(Level.WARNING, f"the IMU was silent {coasting:.1%} of the time: the estimate went on at constant velocity")
        )
    if gathered.counts.get("internal"):
        found.append(
            Finding(Level.WRONG, f"{gathered.counts['internal']} internal errors: defects of the estimator, please report them")
        )
    if (late := e.latency_s.get("/landfix/odometry")) and late.p99 > _LATE_S:
        found.append(Finding(Level.WARNING, f"1 % of the estimates arrived later than {1e3 * late.p99:.0f} ms after their stamp"))
    return found


def _jumps(collected: Collected) -> list[Finding]:
    estimate, start_ns = collected.estimate, int(collected.estimate.t_ns[0])
    jumps = [(float(np.linalg.norm(j.delta_p)), j) for j in collected.resets]
    jumps = [(length_m, j) for length_m, j in jumps if length_m > _JUMP_M]
    if not jumps:
        return []
    before = np.maximum(np.searchsorted(estimate.t_ns, [j.t_ns for _, j in jumps]) - 1, 0)
    radius = horizontal_radius(estimate.covariance[before, :2, :2])
    beyond = [length_m > r for (length_m, _), r in zip(jumps, radius.tolist(), strict=True)]
    k = max(range(len(jumps)), key=lambda k: (beyond[k], jumps[k][0]))
    (length_m, most), many = jumps[k], "once" if len(jumps) == 1 else f"{len(jumps)} times"
    at = f"{length_m:.1f} m at {(most.t_ns - start_ns) * 1e-9:.1f} s, where the reported 95 % radius was {radius[k]:.1f} m"
    return [Finding(Level.WARNING if any(beyond) else Level.FINE, f"the position jumped by more than {_JUMP_M:g} m {many}: {at}")]


def refusals(aid: AidSummary) -> dict[str, int]:
    """Judged, unfused measurements by reason."""
    return {reason: n for reason, n in aid.reasons.items() if reason not in _NOT_JUDGED and reason != Reason.FUSED}


def _source(aid: AidSummary) -> list[Finding]:
    fused, refused = aid.reasons.get("fused", 0), refusals(aid)
    total = fused + sum(refused.values())
    found = []
    if sum(refused.values()) > _MANY_REFUSED * total:
        reasons = ", ".join(f"{n} {reason.replace('_', ' ')}" for reason, n in refused.items())
        found.append(Finding(Level.WARNING, f"{aid.topic}: of {total} {aid.kind} measurements {reasons}"))
    if aid.nis is not None and fused >= _FEW and not _NIS_BAND[0] <= aid.nis <= _NIS_BAND[1]:
        small = aid.nis < 1.0
        meaning = "smaller than its noise and the covariance say" if small else "larger than its noise and the covariance say"
        found.append(
            Finding(
                Level.FINE if small else Level.WARNING,
                f"{aid.topic}: innovations of {aid.kind} are {meaning} (NIS {aid.nis:.2f} per degree of freedom)",
            )
        )
    return found


def _vision(gathered: Gathered) -> list[Finding]:
    reports = [frame.report for frame in gathered.frames.values() if frame.report]
    if len(reports) < _FEW:
        return []
    fixed = sum(r.outcome == "fixed" for r in reports)
    level = Level.FINE if fixed else Level.WARNING
    return [Finding(level, f"vision computed a fix from {fixed} of {len(reports)} image pairs")]


def _log(e: Evaluation, collected: Collected, gathered: Gathered) -> list[Finding]:
    notes = [
        note
        for note in e.notes
        if not note.startswith(("no truth", "errors are computed")) and not note.endswith("has no attitude")
    ]
    found = [Finding(Level.FINE if note.endswith("are no errors") else Level.WARNING, note) for note in notes]
    if collected.skipped_chunks:
        found.append(Finding(Level.WARNING, f"{collected.skipped_chunks} damaged places in the log were skipped"))
    if gathered.unreadable:
        found.append(
            Finding(Level.WARNING, f"unreadable messages: {', '.join(f'{n} on {t}' for t, n in gathered.unreadable.items())}")
        )
    for key, value in gathered.daemon.items():
        if key.endswith(("lost_inputs", "internal_errors", "implausible_stamps")) and value not in {"0", ""}:
            found.append(Finding(Level.WARNING, f"the daemon reports {key.replace('_', ' ')}: {value}"))
    return found
