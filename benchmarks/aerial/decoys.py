"""Images over maps that do not show their place, as in flight: `python -m benchmarks.aerial.decoys [--resume]`.

None of these images and maps chose a threshold. The map is turned by a quarter, mirrored, 150 to 300 m off, or of another place.
Whatever is accepted is wrong, but for the distance from a street that is seen far along it. Of n images without a false fix the
false share is below 3 / n (95 %). Results: out/registration/decoys.jsonl.
"""

import argparse
import math
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import msgspec
import numpy as np

from benchmarks.aerial.registration import judge
from benchmarks.aerial.registration_sets import (
    LOW,
    NEAR,
    Flight,
    Scene,
    brighton_scene,
    learned_models,
    nust_scene,
    shots,
    turned,
    village,
)
from benchmarks.aerial.trials import Spread, generator
from benchmarks.flights.tasks import data_folder
from benchmarks.jobs import run_jobs
from benchmarks.tables import Table
from models.maps.landmarks import LandmarkMap
from vision.ground.image import GroundImage, Heights
from vision.ground.learned import Learned
from vision.recognisers import MapImage, Recognisers
from vision.records.reports import INSIDE_9999

OUT = Path(__file__).resolve().parents[2] / "out" / "registration"
SEED = 1000  # of the priors
VILLAGES = tuple(f"village {seed}" for seed in range(100, 102))
SETS = ("NUST +5", "NUST +10", "Brighton", *VILLAGES)
OWN = ("quarter", "three quarters", "mirrored", "away")
_AWAY_M = (150.0, 300.0)  # beyond what features search by this prior
_NOT_SEARCHED = frozenset({"no_ground", "outside", "prior_too_wide"})
_NOWHERE = LandmarkMap.from_landmarks((0.0, 0.0, 0.0), [])

Job = tuple[str, str]  # images, map


class Counts(msgspec.Struct, frozen=True):
    """Of one set of images over one map: how often each outcome, and what was said of those accepted."""

    outcomes: dict[str, int]
    accepted: list[str]

    @property
    def searched(self) -> int:
        """Images that were compared with the map."""
        return sum(n for outcome, n in self.outcomes.items() if outcome not in _NOT_SEARCHED)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--resume", action="store_true", help="keep the jobs that are done")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--only", default="", help="sets whose name contains this")
    args = parser.parse_args()
    done = [job for job in jobs() if args.only in job[0]]
    kept = OUT / "decoys.jsonl"
    results = run_jobs(done, work, Counts, kept, processes=args.processes, resume=args.resume)
    sys.stdout.write(table(dict(zip(done, results, strict=True))).markdown() + f"\n{kept}\n")


def jobs() -> Iterator[Job]:
    """Every set over its own maps and over those of other places."""
    for images in SETS:
        for known in OWN:
            yield images, known
    for images in SETS:
        for place in ("NUST", *VILLAGES):
            if place not in images:
                yield images, place


def work(job: Job) -> Counts:
    """All images of a set, in order, over one map."""
    images, known = job
    outcomes: Counter[str] = Counter()
    accepted = []
    for number, scene in enumerate(scenes(images)):
        flight = decoy(scene, known, (SEED, f"{images} {known}", number), LOW if images.startswith("Brighton") else NEAR)
        recognisers = Recognisers(flight.rig, _NOWHERE, replace(flight.known, learned=_models()))
        for shot in flight.shots():
            result = recognisers.process(shot.image, None, shot.t_ns, shot.prior)
            if result.fix is None or result.pose is None:
                outcomes[result.report.outcome] += 1
                continue
            off_m, squared, freedom = judge(flight.rig, flight.known.image, shot, result.pose)
            is_right = known == "away" and freedom == 1 and squared < INSIDE_9999[0]
            outcomes["right across a line" if is_right else "fixed"] += 1
            if not is_right:
                accepted.append(f"{off_m:.1f} m off: {result.report.detail}")
    return Counts(dict(outcomes), accepted)


@lru_cache(maxsize=1)
def _models() -> Learned | None:
    return learned_models(data_folder())


@lru_cache(maxsize=2)
def scenes(images: str) -> tuple[Scene, ...]:
    """Of one name: a flight, or a village on three days."""
    if images.startswith("NUST"):
        return (nust_scene(data_folder(), int(images.split("+")[1])),)
    if images == "Brighton":
        return (brighton_scene(data_folder(), OUT / "maps"),)
    return tuple(village(int(images.split()[1])).values())


def decoy(scene: Scene, known: str, key: tuple[int, str, int], spread: Spread) -> Flight:
    """The images over a map where no fix is right."""
    if known == "away":
        return Flight(known, scene.rig, scene.known, shots(scene, spread, key, _AWAY_M))
    turns = {"quarter": cv2.ROTATE_90_CLOCKWISE, "three quarters": cv2.ROTATE_90_COUNTERCLOCKWISE}
    if known in turns:
        other = turned(scene.known, turns[known])
    elif known == "mirrored":
        other = MapImage.of(replace(scene.known.image, image=np.ascontiguousarray(scene.known.image.image[:, ::-1])))
    else:
        other = _moved_to(scene, _place(known), key)
    return Flight(known, scene.rig, other, shots(scene, spread, key))


def _place(known: str) -> GroundImage:
    if known == "NUST":
        return nust_scene(data_folder(), -1).known.image  # none of its frames
    return scenes(known)[0].known.image


def _moved_to(scene: Scene, place: GroundImage, key: tuple[int, str, int]) -> MapImage:
    """The map of another place, turned at random, with its middle where the images are and the ground as far below."""
    middle = np.mean([taken.p_n[:2] for taken in scene.taken], axis=0)
    height, width = place.image.shape[:2]
    angle = generator(*key).uniform(0.0, 2.0 * math.pi)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    linear = turn @ place.affine[:, :2]
    shift = middle - linear @ (0.5 * np.array([width - 1.0, height - 1.0]))
    down = float(scene.known.image.heights.at(middle[None])[0])
    return MapImage.of(replace(place, affine=np.column_stack((linear, shift)), heights=Heights.level(down)))


def table(results: dict[Job, Counts]) -> Table:
    """One row for each kind of images and of map."""
    rows = []
    kinds = dict.fromkeys((images.split()[0], _kind(known)) for images, known in results)
    for images, known in kinds:
        of = [t for (i, k), t in results.items() if (i.split()[0], _kind(k)) == (images, known)]
        rows.append((images, known, *_counts(of)))
    rows.append(("all", "", *_counts(list(results.values()))))
    return Table("Decoys", ("images", "map", "images seen", "searched", "accepted", "share below (95 %)"), rows)


def _kind(known: str) -> str:
    return known if known in OWN else "another place"


def _counts(several: list[Counts]) -> tuple[str, str, str, str]:
    seen, searched = sum(sum(t.outcomes.values()) for t in several), sum(t.searched for t in several)
    false = sum(len(t.accepted) for t in several)
    return str(seen), str(searched), str(false), f"{3.0 / searched:.2%}" if searched and not false else "-"


if __name__ == "__main__":
    main()
