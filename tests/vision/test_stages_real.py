"""The stages on recorded images, skipped where there are none."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.vision import real_pairs
from tests.vision.real_pairs import RealPair
from vision.describe.correspond import Match, Search, correspond
from vision.describe.measure import RECORDED, Unmeasured, measure
from vision.describe.plane import fit_plane
from vision.describe.regions import Limits, find_regions
from vision.describe.segment import segment_seeds
from vision.describe.survey import Settings, Survey, grey, segment_regions, survey
from vision.image import enhance
from vision.image.check import image_flaw
from vision.image.rectify import rectification


def matches_of(pair: RealPair) -> list[Match]:
    settings = Settings(limits=Limits(least_px=200), search=Search(nearest_m=pair.nearest_m))
    regions = segment_regions(pair.left, None, settings)
    found = correspond(grey(pair.left), grey(pair.right), regions, pair.rig, settings.search)
    return [m for m in found if isinstance(m, Match)]


def errors_of(pair: RealPair) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the cells, and per region the median of its cells' errors [px], where the truth is known."""
    cells, regions = [], []
    for match in matches_of(pair):
        error = match.disparities - real_pairs.at(pair.truth, match.points)
        error = error[np.isfinite(error)]
        if len(error) >= 5:
            cells.append(error)
            regions.append(np.median(error))
    return np.concatenate(cells), np.array(regions)


def test_disparity_of_the_motorcycle(landfix_data: Path) -> None:
    cells, regions = errors_of(real_pairs.motorcycle(landfix_data))
    assert len(regions) >= 20
    assert 0.01 < np.median(np.abs(regions)) < 0.12
    assert np.percentile(np.abs(regions), 90) < 0.6
    assert np.median(np.abs(cells)) < 0.2
    assert (np.abs(cells) > 2.0).mean() < 0.1


def test_disparity_of_the_aloe(landfix_data: Path) -> None:
    """The truth is in whole pixels: half a pixel of error is its own."""
    cells, regions = errors_of(real_pairs.aloe(landfix_data))
    assert len(regions) >= 20
    assert np.median(np.abs(regions)) < 0.45
    assert (np.abs(cells) > 2.0).mean() < 0.1


@pytest.mark.parametrize("frame", [0, 25, 50])
def test_disparity_on_the_road(landfix_data: Path, frame: int) -> None:
    cells, regions = errors_of(real_pairs.kitti(landfix_data, frame))
    assert len(regions) >= 5
    assert np.median(np.abs(regions)) < 0.35
    assert (np.abs(cells) > 2.0).mean() < 0.12


def test_flat_regions_on_the_road_are_as_far_off_as_claimed(landfix_data: Path) -> None:
    """Within 3 standard deviations of the plane that semi-global matching sees there, but for regions of two surfaces."""
    pair, off = real_pairs.kitti(landfix_data, 30), []
    for match in matches_of(pair):
        found = measure(match, pair.rig, RECORDED)
        v, u = np.nonzero(match.region.mask)
        px = np.column_stack((u, v)) + match.region.bbox[:2]
        true = real_pairs.at(pair.truth, px)
        known = np.isfinite(true)
        if isinstance(found, Unmeasured) or known.sum() < 100:
            continue
        plane = fit_plane(px[known].astype(float), true[known], np.full(known.sum(), 0.1), np.zeros(2), 1.0)
        assert plane is not None
        residual = np.abs(plane.at(px[known]) - true[known])
        if np.median(residual) < 0.2 and np.mean(residual < 1.0) > 0.9:
            centre = pair.rig.left.project(found.centre_c[None])
            off.append((found.disparity_px - plane.at(centre)[0]) / found.disparity_sigma_px)
    assert len(off) >= 8
    assert np.mean(np.abs(off) > 3.0) <= 0.25


def test_rows_of_recorded_pairs_fit(landfix_data: Path) -> None:
    for pair in (real_pairs.motorcycle(landfix_data), real_pairs.kitti(landfix_data, 10)):
        found = survey(pair.left, pair.right, rectification(pair.rig), Settings(search=Search(nearest_m=pair.nearest_m)))
        assert isinstance(found, Survey)
        assert found.problem is None
        assert found.residual is not None
        assert abs(found.residual.vertical_px) < 0.6  # features on the road differ by 0.4 px


def test_flat_things_stand_where_their_true_disparity_reports(landfix_data: Path) -> None:
    """Boxes, panels and mudguards around the motorcycle: depth from the pair against depth from the true disparity."""
    pair = real_pairs.motorcycle(landfix_data)
    found = survey(pair.left, pair.right, rectification(pair.rig), Settings(search=Search(nearest_m=1.5)))
    assert isinstance(found, Survey)
    checked = 0
    for m in found.measured:
        v, u = np.nonzero(m.region.mask)
        true = np.nanmedian(pair.truth[v + m.region.bbox[1], u + m.region.bbox[0]])
        spread = np.nanpercentile(pair.truth[v + m.region.bbox[1], u + m.region.bbox[0]], (10, 90))
        if np.ptp(spread) < 2.0 and min(m.region.bbox[2:]) >= 20 and not m.region.touches_border:  # as good as flat
            depth = pair.rig.left.fx * pair.rig.baseline_m / (true + 31.086)
            assert m.centre_c[2] == pytest.approx(depth, rel=0.02)
            checked += 1
    assert checked >= 4


def test_thermal_images_have_regions(landfix_data: Path) -> None:
    """Nadir thermal frames: cars and people are warm spots; seeds find regions in all of them."""
    for path in sorted((landfix_data / "images/thermal_nadir_hituav").glob("*.jpg")):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        assert image_flaw(image) is None
        stretched = enhance.stretch(image)
        assert len(find_regions(stretched, segment_seeds(enhance.median(stretched, 5)))) >= 3


def test_sixteen_bit_satellite_image(landfix_data: Path) -> None:
    """16-bit panchromatic, values 54 to 6615: a stretch brings contrast, seeds find building-sized regions on footprints."""
    image = cv2.imread(str(landfix_data / "images/spacenet_atlanta_footprints/sample_geotiff.tif"), cv2.IMREAD_UNCHANGED)
    assert image is not None
    assert image.dtype == np.uint16
    assert image_flaw(image) is None
    stretched = enhance.stretch(image)
    assert stretched.std() > 40
    regions = find_regions(stretched, segment_seeds(enhance.median(stretched, 5)), Limits(most=60))
    assert len(regions) >= 20
