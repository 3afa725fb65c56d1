"""How often regions are identified, and how often wrongly, in worlds of look-alikes: `python -m
benchmarks.identification.numbers`.

Wrong fix: off by more than 3 m and outside its 99.99 % ellipsoid. Wrong identity: another landmark, or none. Beside it the
thesis' rule: the most similar landmark within the prior's 99.99 %, if >= 75 % similar. Objects of +-10 %, 25 m apart, 30 % not in
the map, 10 % of it gone. Writes identification.md to --out.
"""

import argparse
import itertools
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

import msgspec
import numpy as np

from benchmarks.identification.worlds import RIG, Conditions, Frame, draw_error, draw_pose, draw_world, observe
from benchmarks.tables import Table, number
from vision.identify.catalogue import Catalogue, catalogue
from vision.identify.identify import Identification, IdentifyConfig, identify
from vision.identify.likelihood import similarities

INSIDE_9999, GATE_9999 = 21.108, 21.108  # chi-square of 3
OFF_M = 3.0
FRAMES_PER_WORLD = 10
PRIORS_M = (5.0, 10.0, 20.0)
WORLDS = {f"{layout}, prior {sigma:.0f} m": Conditions(layout, sigma) for layout in ("random", "grid") for sigma in PRIORS_M}
STRESS = {
    "half of the objects unmapped": {"unmapped": 0.5},
    "30 % of the map gone": {"gone": 0.3},
    "every gone one replaced in its place": {"replaced": 1.0},
    "half of the objects not segmented": {"found": 0.5},
    "15 % measured badly": {"bad": 0.15},
    "all errors 1.5 x those claimed": {"claim": 1.5},
    "objects differ by +-3 % only": {"variation": 0.03},
}
CONFIG = IdentifyConfig()


class Outcome(msgspec.Struct, frozen=True):
    """One frame of at least 3 regions."""

    regions: int
    fixed: bool
    wrong_fix: bool
    identified: int
    wrong: int
    alone_identified: int
    alone_wrong: int
    alone_wrong_fix: bool
    posterior: tuple[float, ...]  # of the most probable landmark of each region
    right: tuple[bool, ...]
    absent: tuple[float, ...]  # of the regions that are most probably not in the map
    absent_right: tuple[bool, ...]
    seconds: float


def run(conditions: Conditions, frames: int, seed: int) -> list[Outcome]:
    """Frames with at least 3 regions."""
    rng, outcomes, k = np.random.default_rng(seed), list[Outcome](), 0
    world = draw_world(rng, conditions)
    while len(outcomes) < frames:
        if (k := k + 1) % FRAMES_PER_WORLD == 0:
            world = draw_world(rng, conditions)
        p_n, q_nb = draw_pose(rng, conditions)
        frame = observe(rng, world, p_n, q_nb, draw_error(rng, conditions), conditions)
        if len(frame.sightings) >= 3:
            near = world.map.near(frame.prior.p_n[0], frame.prior.p_n[1], 4.0 * conditions.prior_sigma_m + 70.0)
            outcomes.append(judge(frame, catalogue(near)))
    return outcomes


def judge(frame: Frame, landmarks: Catalogue) -> Outcome:
    begin = perf_counter()
    found = identify(frame.sightings, landmarks, frame.prior, RIG, frame.scale_sigma, CONFIG)
    seconds = perf_counter() - begin
    fixed = found.position_posterior >= CONFIG.fix_posterior
    named = [landmarks.ids[k] if k >= 0 else None for k in found.landmark]
    right = [name == truth for name, truth in zip(named, frame.truth, strict=True)]
    identified = found.accepted & fixed
    is_landmark = [k >= 0 for k in found.landmark]
    alone, alone_off = similarity_alone(frame, landmarks)
    alone_right = [name == truth for name, truth in zip(alone, frame.truth, strict=True) if name]
    return Outcome(
        regions=len(right),
        fixed=fixed,
        wrong_fix=fixed and is_wrong(frame, found),
        identified=int(identified.sum()),
        wrong=int((identified & ~np.array(right)).sum()),
        alone_identified=len(alone_right),
        alone_wrong=alone_right.count(False),
        alone_wrong_fix=alone_off > OFF_M,
        posterior=tuple(float(p) for p, k in zip(found.posterior, is_landmark, strict=True) if k),
        right=tuple(r for r, k in zip(right, is_landmark, strict=True) if k),
        absent=tuple(float(p) for p, k in zip(found.posterior, is_landmark, strict=True) if not k),
        absent_right=tuple(t not in landmarks.ids for t, k in zip(frame.truth, is_landmark, strict=True) if not k),
        seconds=seconds,
    )


def is_wrong(frame: Frame, found: Identification) -> bool:
    e = frame.p_n - frame.prior.moved(found.x)[0]
    return bool(np.linalg.norm(e) > OFF_M and e @ np.linalg.solve(found.covariance[:3, :3], e) > INSIDE_9999)


def similarity_alone(frame: Frame, landmarks: Catalogue) -> tuple[list[str | None], float]:
    """Identity of each region by similarity >= 75 %, and how far off the median place then is [m]; 0 without any."""
    like = similarities(frame.sightings, landmarks, np.ones((len(frame.sightings), len(landmarks.ids))))
    arm = np.array([s.arm_n for s in frame.sightings])
    position = landmarks.position_n[None] - arm[:, None]  # of the body, if region i were landmark j
    sigma = np.sqrt(np.diag(frame.prior.covariance)[:3])
    like[(((position - frame.prior.p_n) / sigma) ** 2).sum(axis=-1) > GATE_9999] = 0.0
    if not like.size:
        return [None] * len(arm), 0.0
    best = like.argmax(axis=1)
    known = like.max(axis=1) >= CONFIG.min_similarity
    names = [landmarks.ids[j] if k else None for j, k in zip(best, known, strict=True)]
    chosen = position[np.arange(len(arm)), best][known]
    return names, float(np.linalg.norm(np.median(chosen, axis=0) - frame.p_n)) if known.any() else 0.0


def row(name: str, outcomes: Sequence[Outcome]) -> tuple[str, ...]:
    fixed, ids = sum(o.fixed for o in outcomes), sum(o.identified for o in outcomes)
    wrong, alone = sum(o.wrong for o in outcomes), sum(o.alone_identified for o in outcomes)
    return (
        name, str(len(outcomes)), share(fixed, len(outcomes)), str(sum(o.wrong_fix for o in outcomes)), str(ids), str(wrong),
        share(sum(o.alone_wrong for o in outcomes), alone), share(sum(o.alone_wrong_fix for o in outcomes), len(outcomes)),
        number(1e3 * float(np.median([o.seconds for o in outcomes]))),
    )  # fmt: skip


COLUMNS = ("world", "frames", "fixed", "wrong fixes", "identified", "wrong", "alone: wrong ids", "alone: off > 3 m", "ms")


def share(part: int, whole: int) -> str:
    return f"{100.0 * part / whole:.1f} %" if whole else "-"


def calibration(posterior: Sequence[float], right: Sequence[bool]) -> list[tuple[float, float, float, int]]:
    """Mean claimed probability of being wrong, measured frequency, its standard error and the count, per bin."""
    p, wrong = 1.0 - np.array(posterior), ~np.array(right, np.bool_)
    edges = [0.0, 1e-5, 1e-4, 1e-3, 1e-2, 0.03, 0.1, 0.3, 1.0]
    table = []
    for low, high in itertools.pairwise(edges):
        inside = (p >= low) & (p < high)
        if inside.any():
            count, frequency = int(inside.sum()), float(wrong[inside].mean())
            table.append((float(p[inside].mean()), frequency, np.sqrt(max(frequency, 1.0 / count) / count), count))
    return table


def identities(outcomes: Sequence[Outcome]) -> list[tuple[float, float, float, int]]:
    """Calibration of the most probable landmarks."""
    return calibration([p for o in outcomes for p in o.posterior], [r for o in outcomes for r in o.right])


def absences(outcomes: Sequence[Outcome]) -> list[tuple[float, float, float, int]]:
    """Calibration of "not in the map"."""
    return calibration([p for o in outcomes for p in o.absent], [r for o in outcomes for r in o.absent_right])


def calibration_table(title: str, bins: Sequence[tuple[float, float, float, int]]) -> Table:
    rows = [(f"{claimed:.1e}", f"{measured:.1e} +- {error:.0e}", str(n)) for claimed, measured, error, n in bins]
    return Table(title, ("claimed", "measured", "regions"), rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--frames", type=int, default=1000, help="frames of at least 3 regions, per world")
    parser.add_argument("--stress", action="store_true", help="also worlds that differ from the method's assumptions")
    parser.add_argument("--out", type=Path, default=Path("out/identification"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    results = {}
    for k, (name, conditions) in enumerate(WORLDS.items()):
        results[name] = run(conditions, args.frames, args.seed * 100 + k)
        print(f"{name}: done", flush=True)
    everything = [o for outcomes in results.values() for o in outcomes]
    rows = [row(name, outcomes) for name, outcomes in results.items()]
    tables = [Table("Worlds of look-alikes", COLUMNS, [*rows, row("all", everything)])]
    title = "Probability of a wrong identity (most probable landmark of a region)"
    tables.append(calibration_table(title, identities(everything)))
    tables.append(calibration_table('Probability that "not in the map" is wrong', absences(everything)))
    if args.stress:
        rows = []
        for k, (name, change) in enumerate(STRESS.items()):
            for layout in ("random", "grid"):
                c = msgspec.structs.replace(Conditions(layout, 10.0), **change)
                rows.append(row(f"{layout}: {name}", run(c, args.frames, args.seed * 100 + 50 + k)))
        tables.append(Table("Worlds other than assumed, prior 10 m", COLUMNS, rows))
    text = "\n".join(table.markdown() for table in tables)
    print(text)
    (args.out / "identification.md").write_text(text)


if __name__ == "__main__":
    main()
