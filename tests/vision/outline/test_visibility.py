"""Which edges of extruded landmarks are seen, and how their ends follow the errors of a map."""

import numpy as np
import pytest

from models.maps.landmarks import Landmark
from vision.outline.visibility import Kind, MapError, Prisms, hidden, visible_edges

SQUARE = np.array([[-4.0, -6.0], [-4.0, 6.0], [4.0, 6.0], [4.0, -6.0]])
ELL = np.array([[-6.0, -6.0], [-6.0, 6.0], [0.0, 6.0], [0.0, 0.0], [6.0, 0.0], [6.0, -6.0]])


def box(outline: np.ndarray = SQUARE, height: float = 3.0) -> Landmark:
    return Landmark.of("a", outline, 0.0, height)


def kinds(mark: Landmark, p: list[float]) -> list[int]:
    counts: list[int] = np.bincount(visible_edges([mark], np.array(p)).kind, minlength=3).tolist()
    return counts


def test_from_right_above_only_the_roof_is_seen() -> None:
    assert kinds(box(), [0.0, 0.0, -60.0]) == [4, 0, 0]


@pytest.mark.parametrize(("p", "sides", "uprights"), [([30.0, 0.0, -60.0], 1, 2), ([30.0, 30.0, -60.0], 2, 3)])
def test_sides_that_face_the_camera_show_their_feet_and_corners(p: list[float], sides: int, uprights: int) -> None:
    assert kinds(box(), p) == [4, sides, uprights]
    edges = visible_edges([box()], np.array(p))
    for base in np.flatnonzero(edges.kind == Kind.BASE):
        roof = edges.partner[base]
        assert edges.kind[roof] == Kind.ROOF
        assert edges.partner[roof] == base
        np.testing.assert_allclose(edges.start_n[base] - edges.start_n[roof], [0.0, 0.0, 3.0])
        towards = np.array(p)[:2] - 0.5 * (edges.start_n[base] + edges.end_n[base])[:2]
        assert np.sign(towards) @ np.sign(0.5 * (edges.start_n[base] + edges.end_n[base])[:2]) > 0


def test_a_roof_lower_than_mapped_does_not_hide_its_own_edges() -> None:
    """What hides moves along: else the mapped roof, half a metre above the true one, hides the far sides."""
    marks, p, shift = Prisms.of([box(), box(ELL + 40.0)]), np.array([30.0, 30.0, -60.0]), np.zeros((2, len(MapError)))
    shift[:, [MapError.NORTH, MapError.RISE, MapError.GROWTH]] = [[0.3, -0.5, -0.2], [-0.4, -0.2, 0.3]]
    edges = visible_edges(marks, p, shift)
    roof = edges.kind == Kind.ROOF
    points = np.concatenate([edges.start_n[roof] + t * (edges.end_n - edges.start_n)[roof] for t in (0.1, 0.5, 0.9)])
    assert hidden(points, p, marks).any()
    assert not hidden(points, p, marks.moved(shift)).any()


def test_painted_on_the_ground_or_above_the_camera() -> None:
    assert kinds(box(height=0.0), [30.0, 30.0, -60.0]) == [4, 0, 0]
    assert kinds(box(height=70.0), [30.0, 30.0, -60.0]) == [0, 0, 0]


def test_nearly_flat_corners_make_no_edge() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)
    assert kinds(box(5.0 * np.column_stack((np.cos(angle), np.sin(angle)))), [40.0, 0.0, -60.0])[2] == 2  # the silhouettes


def test_ends_follow_the_map_errors() -> None:
    """Derivatives against differences, for every unknown and for corners that are not right angles."""
    mark, p = box(np.array([[-4.0, -6.0], [-3.0, 7.0], [5.0, 4.0], [2.0, -5.0]])), np.array([30.0, 20.0, -60.0])
    here = visible_edges([mark], p)
    for error in MapError:
        shift = np.zeros((1, len(MapError)))
        shift[0, error] = 0.01
        there = visible_edges([mark], p, shift)
        np.testing.assert_allclose((there.start_n - here.start_n) / 0.01, here.map_start[:, :, error], atol=1e-9)
        np.testing.assert_allclose((there.end_n - here.end_n) / 0.01, here.map_end[:, :, error], atol=1e-9)


def test_growth_moves_every_side_outwards_by_the_same_distance() -> None:
    shift = np.array([[0.0, 0.0, 0.0, 0.5, 0.0, 0.0]])
    edges = visible_edges([box()], np.array([0.0, 0.0, -60.0]), shift)
    np.testing.assert_allclose(np.abs(edges.start_n[:, :2]), np.tile([4.5, 6.5], (4, 1)))


def test_a_notch_hides_its_inner_walls_from_behind() -> None:
    """The camera is low over the thick end of an L: the ground in the notch close to the wall is hidden, far out it is not."""
    p = np.array([-40.0, 3.0, -20.0])
    points = np.array([[0.2, 3.0, 0.0], [30.0, 3.0, 0.0], [0.0, 3.0, -3.0]])
    assert hidden(points, p, [box(ELL)]).tolist() == [True, False, False]
    assert not hidden(points, p, [box(ELL, height=0.0)]).any()


def test_hidden_agrees_with_rays() -> None:
    """Against marching along the line of sight and asking of each point whether it is inside the prism."""
    rng = np.random.default_rng(3)
    mark = box(ELL, 5.0)
    p = np.array([-25.0, 18.0, -30.0])
    points = np.column_stack((rng.uniform(-20, 20, (400, 2)), np.zeros(400)))
    outside = ~_inside(points[:, :2])
    points = points[outside]
    steps = np.linspace(0.0, 1.0, 4001)[None, :, None]
    ray = points[:, None, :] + steps * (p - points[:, None, :])
    inside = _inside(ray[:, :, :2].reshape(-1, 2)).reshape(ray.shape[:2]) & (ray[:, :, 2] > -5.0)
    clear = np.count_nonzero(inside, axis=1)
    expected = clear > 0
    decided = (clear == 0) | (clear > 20)  # not those that graze a corner
    assert 20 < expected.sum() < 200
    assert (hidden(points, p, Prisms.of([mark])) == expected)[decided].all()


def _inside(xy: np.ndarray) -> np.ndarray:
    n, e = xy.T
    result: np.ndarray = ((n > -6) & (n < 0) & (e > -6) & (e < 6)) | ((n >= 0) & (n < 6) & (e > -6) & (e < 0))
    return result
