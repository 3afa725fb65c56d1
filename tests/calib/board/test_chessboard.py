import cv2
import numpy as np
import pytest

from calib.board.chessboard import Board, View, Why, find, size_around, size_seen
from calib.board.corners import Grey
from calib.cameras.bundle import IDENTITY, Pose
from calib.errors import CalibrationError
from calib.files.fisheye import rational
from models import so3
from models.camera import CameraModel
from tests.boards import views
from tests.calib.conftest import BOARD, CAMERA, SMALL
from vision.image.rectify import Image


def view_of(image: Image, board: Board = BOARD) -> View:
    found = find(image, board)
    assert isinstance(found, View)
    return found


def test_corners_of_rendered_boards_are_found_to_a_tenth_of_a_pixel() -> None:
    rng = np.random.default_rng(3)
    painter = views.Painter(CAMERA, BOARD)
    errors = []
    for pose in views.poses([(CAMERA, IDENTITY)], BOARD, 4, rng):
        found = find(painter.paint(pose, rng), BOARD)
        if isinstance(found, View):
            errors.append(found.px - CAMERA.project(pose.of(BOARD.points)))
    assert len(errors) >= 3
    assert np.sqrt(np.mean(np.square(errors))) < 0.1
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.02  # no half-pixel shift of conventions


def test_a_corner_that_a_wide_lens_bends_off_the_pattern_stays_where_it_is() -> None:
    """Homography and cubic miss the end of a near board at a fisheye's border by 18 px: there is no corner there."""
    wide = rational(310.0, 311.0, 322.0, 238.0, np.array([-0.02, 0.006, -0.003, 0.0004]), (640, 480))
    pose = Pose(so3.matrix(so3.quat_exp(np.array([-0.601, 0.243, -0.302]))), np.array([-0.1103, -0.0077, 0.1847]))
    found = view_of(views.Painter(wide, BOARD).paint(pose, np.random.default_rng(0)))
    assert np.abs(found.px - wide.project(pose.of(BOARD.points))).max() < 0.1


def test_curved_edges_do_not_pull_the_corners() -> None:
    """Near boards towards the border of a strong lens: refined as if edges were straight, corners lie 0.008 px too far out."""
    strong = CameraModel(640, 480, 500.0, 500.0, 320.0, 240.0, (-0.32, 0.09, 0.0, 0.0))
    painter, outwards = views.Painter(strong, BOARD), list[float]()
    tilt = so3.matrix(so3.quat_exp(np.array([0.1, -0.1, 0.25])))
    for x, y in ((-0.17, -0.1), (0.0, -0.1), (-0.17, 0.0), (-0.03, 0.0)):
        pose = Pose(tilt, np.array([x, y, 0.31]))
        truth = strong.project(pose.of(BOARD.points))
        error = view_of(painter.paint(pose, np.random.default_rng(0), noise=0.5)).px - truth
        away = truth - (320.0, 240.0)
        far = np.linalg.norm(away, axis=1) > 180.0
        outwards += (np.sum(error * away, axis=1)[far] / np.linalg.norm(away, axis=1)[far]).tolist()
    assert len(outwards) > 80
    assert abs(np.mean(outwards)) < 0.004


@pytest.mark.parametrize(("columns", "rows", "most_px"), [(9, 6, 0.02), (5, 4, 0.031)])
def test_light_that_falls_off_does_not_pull_the_corners(columns: int, rows: int, most_px: float) -> None:
    """A quarter of the light in the image's corners: taken for even, corners are off by 0.029 and 0.037 px, not by 0.016.

    The smaller board has bright squares for a plane only.
    """
    board, rng = Board(columns, rows, 0.2 / columns), np.random.default_rng(8)
    painter, (v, u) = views.Painter(CAMERA, board), np.mgrid[0:480, 0:640]
    light = 1.0 - 0.75 * ((u - 320.0) ** 2 + (v - 240.0) ** 2) / (320.0**2 + 240.0**2)
    errors = []
    for pose in views.poses([(CAMERA, IDENTITY)], board, 6, rng):
        image = np.rint(painter.paint(pose, rng, noise=0.0) * light).astype(np.uint8)
        errors.append(view_of(image, board).px - CAMERA.project(pose.of(board.points)))
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) < most_px


def test_corners_at_the_border_are_as_good_as_others() -> None:
    """The window of the refinement ends where the image does: continued beyond, it pulls a corner by up to half a pixel."""
    painter = views.Painter(CAMERA, BOARD)
    pose = Pose(so3.matrix(so3.quat_exp(np.array([0.05, -0.04, 0.03]))), np.array([-0.1, -0.004, 0.25]))
    truth = CAMERA.project(pose.of(BOARD.points))
    assert 5.0 < 479.0 - truth[:, 1].max() < 7.0
    assert np.abs(view_of(painter.paint(pose, np.random.default_rng(0))).px - truth).max() < 0.09


def test_a_rendered_edge_lies_where_it_should() -> None:
    """Edges along the pixels: the grey level of the pixel that one crosses is its covered part."""
    flat = CameraModel(320, 240, 200.0, 200.0, 160.0, 120.0)
    board = Board(5, 4, 0.02)
    for shift in (0.0, 0.13, 0.31, 0.5, 0.77):
        pose = Pose(np.eye(3), np.array([(0.13 + shift) / 200.0 * 0.2, 0.0, 0.2]))
        image = views.Painter(flat, board).paint(pose, np.random.default_rng(0), noise=0.0, blur_px=0.0)
        row = image[129].astype(float)  # of a dark square that begins at u = 160 + 0.13 + shift
        edge = 160.13 + shift
        k = round(edge)
        assert abs(row[k] - (30.0 + 190.0 * (edge - (k - 0.5)))) < 6.0 or abs(row[k] - (220.0 - 190.0 * (edge - (k - 0.5)))) < 6.0


def test_a_board_upside_down_has_its_corners_in_the_same_order() -> None:
    rng = np.random.default_rng(4)
    painter = views.Painter(CAMERA, BOARD)
    half_turn = so3.matrix(so3.quat_exp(np.array([0.0, 0.0, np.pi])))
    centre = np.array([0.0, 0.0, 0.45])
    for R in (np.eye(3), half_turn):
        pose = Pose(R, centre - R @ BOARD.points.mean(axis=0))
        np.testing.assert_allclose(view_of(painter.paint(pose, rng)).px, CAMERA.project(pose.of(BOARD.points)), atol=0.6)


@pytest.mark.parametrize("size", [(9, 6), (7, 6), (6, 4), (8, 8)])
def test_any_size(size: tuple[int, int]) -> None:
    board = Board(*size, 0.02)
    pose = Pose(np.eye(3), np.array([0.0, 0.0, 0.5]) - board.points.mean(axis=0))
    image = views.Painter(CAMERA, board).paint(pose, np.random.default_rng(0))
    assert len(view_of(image, board).px) == size[0] * size[1]


def test_colour_and_sixteen_bits_and_large_images_are_taken() -> None:
    pose = Pose(np.eye(3), np.array([0.0, 0.0, 0.5]) - BOARD.points.mean(axis=0))
    image = views.Painter(CAMERA, BOARD).paint(pose, np.random.default_rng(0))
    plain = view_of(image).px
    np.testing.assert_allclose(view_of(np.dstack([image] * 3)).px, plain, atol=0.05)
    np.testing.assert_allclose(view_of(image.astype(np.uint16) * 40 + 9000).px, plain, atol=0.2)
    big = np.asarray(cv2.resize(image, None, fx=4.0, fy=4.0, interpolation=cv2.INTER_CUBIC))
    np.testing.assert_allclose((view_of(big).px + 0.5) / 4.0 - 0.5, plain, atol=0.2)


def test_charuco_corners_carry_their_identity_though_a_part_is_hidden() -> None:
    board = Board(9, 6, 0.03, 0.022)
    image = np.asarray(board.charuco.generateImage((1000, 700), marginSize=30), dtype=np.uint8)
    whole = view_of(image, board)
    assert len(whole.ids) == 54
    image[:, :350] = 128
    part = view_of(image, board)
    assert 10 < len(part.ids) < 54
    both, a, b = np.intersect1d(whole.ids, part.ids, return_indices=True)
    assert len(both) == len(part.ids)
    np.testing.assert_allclose(whole.px[a], part.px[b], atol=1.0)
    step = whole.px[1] - whole.px[0]
    np.testing.assert_allclose(step / np.linalg.norm(step), (1.0, 0.0), atol=0.01)


def test_blurred_empty_and_other_boards_are_distinguished(images: list[Grey]) -> None:
    sharp = next(p for p in images if isinstance(find(p, BOARD), View))
    near = Pose(np.eye(3), np.array([0.0, 0.0, 0.25]) - BOARD.points.mean(axis=0))
    image = views.Painter(SMALL, BOARD).paint(near, np.random.default_rng(0))
    assert find(cv2.GaussianBlur(image, (0, 0), 4.0), BOARD) is Why.BLURRED
    assert find(np.full((240, 320), 128, np.uint8), BOARD) is Why.NOT_FOUND
    assert find(sharp, Board(7, 7, 0.025)) is Why.NOT_FOUND
    assert size_seen(sharp, Board(10, 7, 0.025)) == (9, 6)
    assert size_seen(np.full((240, 320), 128, np.uint8), BOARD) is None
    assert size_around(sharp, Board(8, 6, 0.025)) == (9, 6)
    assert size_around(sharp, BOARD) is None


@pytest.mark.parametrize("numbers", [(2, 6, 0.025, 0.0), (9, 6, 0.0, 0.0), (9, 6, 0.025, 0.03)])
def test_boards_that_cannot_be_are_refused(numbers: tuple[int, int, float, float]) -> None:
    with pytest.raises(CalibrationError):
        Board(*numbers)


def test_the_renderer_puts_corners_where_the_camera_model_predicts() -> None:
    """Away from the corner finder: the edge between two squares crosses half grey where the model projects it."""
    flat = CameraModel(200, 100, 100.0, 100.0, 99.5, 49.5)
    board = Board(4, 3, 0.5)
    image = views.Painter(flat, board).paint(Pose(np.eye(3), np.array([-0.75, -0.5, 2.0])), np.random.default_rng(0), 0.0, 0.0)
    row = image[37].astype(float)  # through the middle of a row of squares
    crossing = [k + (125.0 - row[k]) / (row[k + 1] - row[k]) for k in np.flatnonzero((row[:-1] < 125.0) != (row[1:] < 125.0))]
    np.testing.assert_allclose(crossing, [11.1, 62.0, 87.0, 112.0, 137.0, 187.9], atol=0.1)
