"""What the stages cost, beside SIFT + FLANN on the same pictures in the same rounds; and how right their disparities are.

    python -m pytest benchmarks/test_vision_stages.py -q -s

Nothing is asserted about time. Times are of the processor, one thread, so that other work on the machine counts less; the ratio
is between two things measured one after the other. Pictures: a rendered pair with lens distortion and at least 500 SIFT points.
"""

import time
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from benchmarks.tasks import data_folder
from models.messages import Array
from tests.vision import real_pairs, roofs
from tests.vision.real_pairs import RealPair
from vision import check, enhance
from vision.correspond import Match, Search, correspond
from vision.measure import measure
from vision.rectify import Image, rectification, rectify
from vision.regions import Limits, find_regions
from vision.segment import classes, colour_table, segment_colours, segment_seeds
from vision.survey import Settings, grey, segment_regions

ROUNDS = 50
STAGES = ("check", "rectify", "median", "segment", "regions", "correspond", "measure", "all stages")


class Pipeline:
    """The stages on one rig, each timed."""

    def __init__(self, view: roofs.View) -> None:
        self.view, self.made = view, rectification(view.rig)
        self.table = colour_table(classes([m.colour_bgr for m in view.landmarks if m.colour_bgr is not None]))
        self.measured = 0

    def seconds(self) -> list[float]:
        """Of each stage, then of all."""
        assert self.made.left is not None
        marks = [time.process_time()]

        def lap() -> None:
            marks.append(time.process_time())

        left, right = self.view.left, self.view.right
        assert check.picture_flaw(left) is None
        assert check.picture_flaw(right) is None
        assert check.pair_flaw(left, right) is None
        lap()
        seen, other = rectify(left, self.made.left), rectify(grey(right), self.made.right)
        lap()
        smooth = enhance.median(seen, 3)
        lap()
        labels = segment_colours(smooth, self.table)
        lap()
        regions = find_regions(seen, labels, Limits(most=20), self.made.left.valid)
        lap()
        matches = correspond(grey(seen), other, regions, self.made.rig, Search(nearest_m=8.0))
        lap()
        self.measured = sum(measure(m, self.made.rig) is not None for m in matches if isinstance(m, Match))
        lap()
        return [*np.diff(marks).tolist(), marks[-1] - marks[0]]


def sift_and_flann(left: Image, right: Image) -> tuple[float, int, int]:
    """Seconds, key points and inliers of SIFT + FLANN: ratio 0.75, homography by RANSAC at 3 px, at least 10 inliers."""
    start = time.process_time()
    sift = cv2.SIFT.create(1000)
    (a, da), (b, db) = (sift.detectAndCompute(grey(x), np.array([])) for x in (left, right))
    pairs = cv2.FlannBasedMatcher({"algorithm": 1, "trees": 5}, {"checks": 50}).knnMatch(da, db, k=2)
    good = [m for m, n in pairs if m.distance < 0.75 * n.distance]
    source = np.array([a[m.queryIdx].pt for m in good], dtype=np.float32)
    target = np.array([b[m.trainIdx].pt for m in good], dtype=np.float32)
    _, inliers = cv2.findHomography(source, target, cv2.RANSAC, 3.0)
    seconds = time.process_time() - start
    assert inliers.sum() >= 10
    return seconds, min(len(a), len(b)), int(inliers.sum())


@pytest.mark.parametrize(("name", "width", "height", "f"), [("VGA", 640, 480, 600.0), ("720p", 1280, 720, 1100.0)])
def test_time_per_stage(name: str, width: int, height: int, f: float) -> None:
    """p50 and p99 of each stage, all stages as a part of SIFT + FLANN, pairs a second."""
    cv2.setNumThreads(1)
    rig = roofs.nadir_rig(width, height, f, lens=(-0.12, 0.08, 0.0005, -0.0003), squint_rad=0.004)
    pipeline = Pipeline(roofs.view(3, 30.0, rig=rig))
    for _ in range(3):
        pipeline.seconds()
    ours, theirs = [], []
    for _ in range(ROUNDS):
        ours.append(pipeline.seconds())
        seconds, points, inliers = sift_and_flann(pipeline.view.left, pipeline.view.right)
        theirs.append(seconds)
        assert points >= 500
    table = 1e3 * np.array(ours)
    print(f"\n{name}: {pipeline.measured} regions measured; SIFT: {points} key points, {inliers} inliers")
    for k, stage in enumerate(STAGES):
        print(f"  {stage:12s} p50 {np.median(table[:, k]):7.2f} ms   p99 {np.percentile(table[:, k], 99):7.2f} ms")
    sift = 1e3 * np.array(theirs)
    print(f"  SIFT + FLANN p50 {np.median(sift):7.2f} ms   p99 {np.percentile(sift, 99):7.2f} ms")
    ratio = np.median(sift / table[:, -1])
    print(f"  all stages are 1/{ratio:.1f} of SIFT + FLANN; {1e3 / np.median(table[:, -1]):.0f} pairs a second, one core")


def _line(name: str, errors: Array, regions: Array) -> str:
    return (
        f"{name:24s} {len(regions):4d} regions: median |error| {np.median(np.abs(regions)):.3f} px, "
        f"90 % {np.percentile(np.abs(regions), 90):.2f} px; {len(errors):5d} cells: median {np.median(np.abs(errors)):.3f} px, "
        f"> 2 px {(np.abs(errors) > 2).mean():.1%}"
    )


def _errors(pair: RealPair) -> tuple[Array, Array]:
    settings = Settings(limits=Limits(least_px=200), search=Search(nearest_m=pair.nearest_m))
    found = correspond(grey(pair.left), grey(pair.right), segment_regions(pair.left, None, settings), pair.rig, settings.search)
    cells, regions = [], []
    for match in found:
        if isinstance(match, Match):
            error = match.disparities - real_pairs.at(pair.truth, match.points)
            error = error[np.isfinite(error)]
            if len(error) >= 5:
                cells.append(error)
                regions.append(float(np.median(error)))
    return np.concatenate(cells), np.array(regions)


def test_disparity_on_recorded_pairs() -> None:
    """Region by region: the median of its cells' errors against the truth at the same places."""
    folder = data_folder()
    if not (folder / "images").is_dir():
        pytest.skip("no recorded pictures: set LANDFIX_DATA to the folder that holds images/")
    makers: list[tuple[str, Callable[[], list[RealPair]]]] = [
        ("Middlebury motorcycle", lambda: [real_pairs.motorcycle(folder)]),
        ("Middlebury aloe", lambda: [real_pairs.aloe(folder)]),
        ("KITTI 06 against SGM", lambda: [real_pairs.kitti(folder, k) for k in range(0, 51, 5)]),
    ]
    print()
    for name, make in makers:
        parts = [_errors(pair) for pair in make()]
        print(_line(name, np.concatenate([c for c, _ in parts]), np.concatenate([r for _, r in parts])))


def test_time_of_seeds() -> None:
    """Segmentation without known colours."""
    cv2.setNumThreads(1)
    view = roofs.view(3, 30.0)
    smooth = enhance.median(view.left, 3)
    segment_seeds(smooth)
    start = time.process_time()
    for _ in range(ROUNDS):
        segment_seeds(smooth)
    print(f"\nseed segmentation, VGA: {1e3 * (time.process_time() - start) / ROUNDS:.2f} ms")
