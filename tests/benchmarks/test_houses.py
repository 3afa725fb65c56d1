"""Footprints out of masks, roofs out of a city model, decoys, and the naive search that real houses are compared with."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.aerial.trials import nadir_rig
from benchmarks.houses.lod_loc import roofs
from benchmarks.houses.tiles import Tile, elsewhere, footprints, shifted
from benchmarks.houses.trials import naive
from models.messages import Array
from models.prior import Prior
from vision.image.rectify import Image

SIZE, STEP_M = 200, 0.5
BOXES = ((40, 60, 30, 20), (120, 50, 18, 40), (90, 130, 50, 16))  # u, v, width, height


def mask(boxes: tuple[tuple[int, int, int, int], ...] = BOXES) -> Image:
    drawn: Image = np.zeros((SIZE, SIZE), dtype=np.uint8)
    for u, v, width, height in boxes:
        drawn[v : v + height, u : u + width] = 255
    return drawn


def tile() -> Tile:
    image = np.full((SIZE, SIZE, 3), 90, dtype=np.uint8)
    image[mask() > 0] = 180
    return Tile("group", "name", image, STEP_M, footprints(mask(), STEP_M))


def test_a_footprint_is_where_the_mask_has_it() -> None:
    found = sorted(footprints(mask(), STEP_M), key=lambda m: float(m.centre_n[1]))
    centres = sorted(((99.5 - v - (h - 1) / 2, u + (w - 1) / 2 - 99.5) for u, v, w, h in BOXES), key=lambda c: c[1])
    np.testing.assert_allclose([m.centre_n for m in found], STEP_M * np.array(centres), atol=0.3)
    assert found[0].length_m == pytest.approx(30 * STEP_M, abs=0.5)


def test_what_the_border_cuts_and_what_is_tiny_is_left_out() -> None:
    assert footprints(mask(((0, 50, 30, 20), (180, 50, 20, 20), (60, 60, 4, 4))), STEP_M) == ()


@pytest.mark.parametrize("kind", ["turned", "mirrored", "moved", "another town"])
def test_a_decoy_has_the_same_houses_elsewhere(kind: str) -> None:
    here = tile()
    other = Tile("other", "name", here.image, 2.0 * STEP_M, footprints(mask(), 2.0 * STEP_M))
    marks = elsewhere(here, kind, [other], np.random.default_rng(0), 8.0)
    assert [m.length_m for m in marks] == pytest.approx([m.length_m for m in here.marks], rel=1e-6)
    apart = {"another town": 0.0, "moved": 64.0}.get(kind, 5.0)  # 8 times what the prior leaves open
    off = np.linalg.norm([np.subtract(a.centre_n, b.centre_n) for a, b in zip(marks, here.marks, strict=True)], axis=1)
    assert off.max() >= apart


@pytest.mark.parametrize(("together", "off"), [(True, [3.0, 3.0, 3.0]), (False, [0.0, 0.0, 3.0])])
def test_a_map_in_error_is_off_as_a_whole_or_a_third_of_it_is(together: bool, off: list[float]) -> None:
    marks = shifted(tile().marks, np.random.default_rng(1), 3.0, together=together)
    steps = np.array([np.subtract(a.centre_n, b.centre_n) for a, b in zip(marks, tile().marks, strict=True)])
    assert sorted(np.linalg.norm(steps, axis=1)) == pytest.approx(off)
    assert np.ptp(steps, axis=0).max() < 1e-9 or not together


def test_the_naive_search_finds_boxes_of_one_colour() -> None:
    here, off = tile(), np.array([6.0, -9.0, 0.0])
    prior = Prior(here.p_n + off, np.array([1.0, 0.0, 0.0, 0.0]), np.diag([25.0, 25.0, 1.0, 1e-4, 1e-4, 1e-4]))
    found: Array = naive(here.image, nadir_rig(here.camera), here.marks, prior)
    assert float(np.linalg.norm(found - here.p_n)) < 1.0


def test_a_roof_of_a_city_model_stands_on_its_own_ground(tmp_path: Path) -> None:
    """Two boxes, east north up, of 10 m x 6 m, 4 and 9 m high on ground of 20 and 30 m; the second one is far away."""
    lines = []
    for east, ground, height in ((100.0, 20.0, 4.0), (900.0, 30.0, 9.0)):
        for up in (ground, ground + height):
            lines += [f"v {east + x} {50.0 + y} {up}" for x, y in ((0.0, 0.0), (10.0, 0.0), (10.0, 6.0), (0.0, 6.0))]
    for first in (1, 9):
        top = [first + k for k in range(4, 8)]
        walls = [(first + k, first + (k + 1) % 4, top[(k + 1) % 4], top[k]) for k in range(4)]
        lines += [f"f {' '.join(f'{i}/{i}/1' for i in face)}" for face in (*walls, top, range(first + 3, first - 1, -1))]
    (tmp_path / "model.obj").write_text("# two boxes\n" + "\n".join(lines))
    (roof,) = roofs(tmp_path / "model.obj", np.array([50.0, 100.0]))
    assert (roof.base_d, roof.roof_d, roof.size_m2) == pytest.approx((-20.0, -24.0, 60.0))
    assert roof.centre_n == pytest.approx((53.0, 105.0))
