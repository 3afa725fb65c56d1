"""Derivatives of the outline's samples, against differences of the projection itself, on the object the fit uses."""

import numpy as np
import pytest

from models import so3
from models.camera import CameraModel, StereoRig
from models.maps.landmarks import Landmark
from models.messages import Array
from vision.outline.visibility import Kind, MapError, ModelEdges, visible_edges
from vision.pose.sensitivity import MAPPED_FROM, EdgeView, Eye, Samples, derived, edge_gaps, eyes, sample_edges, view

NADIR = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
CAMERA = CameraModel(640, 480, 600.0, 590.0, 319.5, 239.5, (-0.1, 0.03, 1e-3, -5e-4))
TURN = so3.matrix(so3.quat_exp(np.array([0.02, -0.01, 0.03])))
RIG = StereoRig(CAMERA, CAMERA, TURN, np.array([-0.3, 0.01, 0.02]), NADIR @ TURN, np.array([0.1, -0.05, 0.08]))
MARK = Landmark.of("a", [(-4.0, -6.0), (-3.0, 7.0), (5.0, 4.0), (2.0, -5.0)], 0.0, 3.0)
P, R = np.array([6.0, 7.0, -40.0]), so3.matrix(so3.from_euler(0.1, -0.15, 0.7))
STEP = 1e-6


def moved(rotation: Array, axis: int) -> Array:
    turn: Array = so3.matrix(so3.quat_exp(STEP * np.eye(3)[axis])) @ rotation
    return turn


def shifted(rig: StereoRig, which: str, k: int) -> StereoRig:
    """The rig with one unknown of covariance_bc or covariance_rc moved by STEP."""
    parts = {"R_rc": rig.R_rc, "t_rc": rig.t_rc, "R_bc": rig.R_bc, "p_bc": rig.p_bc}
    position, turn = ("p_bc", "R_bc") if which == "bc" else ("t_rc", "R_rc")
    if k < 3:
        parts[position] = parts[position] + STEP * np.eye(3)[k]
    else:
        parts[turn] = moved(parts[turn], k - 3)
    return StereoRig(rig.left, rig.right, parts["R_rc"], parts["t_rc"], parts["R_bc"], parts["p_bc"])


def derivatives(edges: ModelEdges, samples: Samples, seen: EdgeView, eye: Eye) -> tuple[Array, Array]:
    """As the fit asks for them, of all the camera's parameters."""
    return derived(
        seen.row_c, seen.x_c, seen.normal, samples.points_n, samples.t, samples.edge, edges.map_start, edges.map_end,
        *eye.stand(P, R), eye.camera.parameters, 4 + len(eye.camera.distortion), RIG.p_bc, RIG.t_rc, eye.right,
    )  # fmt: skip


@pytest.mark.parametrize("right", [False, True])
def test_rows_are_derivatives(right: bool) -> None:
    eye = eyes(RIG)[right]
    edges = visible_edges([MARK], eye.pose(P, R)[0])
    samples = sample_edges(edges, eye, P, R, 10.0, 8)
    seen = view(edges, samples, eye, P, R, [MARK])
    rows, _ = derivatives(edges, samples, seen, eye)
    assert seen.usable.all()

    def along_normal(other: Eye, p: Array, rotation: Array, points: Array = samples.points_n) -> Array:
        position, axes = other.pose(p, rotation)
        change: Array = np.sum((other.camera.project((points - position) @ axes) - seen.px) * seen.normal, axis=1) / STEP
        return change

    for k in range(3):
        np.testing.assert_allclose(rows[:, k], along_normal(eye, P + STEP * np.eye(3)[k], R), atol=2e-5)
        np.testing.assert_allclose(rows[:, 3 + k], along_normal(eye, P, moved(R, k)), atol=1e-2, rtol=1e-5)
    for k in MapError:
        error = np.zeros((1, len(MapError)))
        error[0, k] = STEP
        there = visible_edges([MARK], eye.pose(P, R)[0], error)
        points = there.start_n[samples.edge] + samples.t[:, None] * (there.end_n - there.start_n)[samples.edge]
        np.testing.assert_allclose(rows[:, MAPPED_FROM + k], along_normal(eye, P, R, points), atol=2e-5)
    for k in range(6):
        for which, begin in (("bc", 6), ("rc", 12)):
            other = eyes(shifted(RIG, which, k))[right]
            np.testing.assert_allclose(rows[:, begin + k], along_normal(other, P, R), atol=1e-2 if k > 2 else 2e-5, rtol=1e-5)


def test_own_parameters_are_the_cameras() -> None:
    eye = eyes(RIG)[0]
    edges = visible_edges([MARK], eye.pose(P, R)[0])
    samples = sample_edges(edges, eye, P, R, 10.0, 8)
    seen = view(edges, samples, eye, P, R, [MARK])
    _, own = derivatives(edges, samples, seen, eye)
    np.testing.assert_allclose(own, np.einsum("ni,nij->nj", seen.normal, CAMERA.parameter_jacobian(seen.x_c)))


def test_normals_of_roofs_point_outwards_and_gaps_are_walls() -> None:
    """From the north-east the sides there are seen: their feet lie outwards of the roof edge, as far as projection says."""
    eye = eyes(StereoRig(CAMERA, CAMERA, np.eye(3), np.array([-0.3, 0.0, 0.0]), NADIR, np.zeros(3)))[0]
    p, level = np.array([12.0, 12.0, -40.0]), np.eye(3)
    edges = visible_edges([MARK], p)
    samples = sample_edges(edges, eye, p, level, 5.0, 20)
    seen = view(edges, samples, eye, p, level, [MARK])
    middle = eye.camera.project((np.array([[0.0, 0.0, -3.0]]) - p) @ NADIR)
    roofs = edges.kind[samples.edge] == Kind.ROOF
    assert (np.sum((seen.px - middle) * seen.normal, axis=1)[roofs] > 0.0).all()
    gaps = edge_gaps(edges, samples, seen, eye, p, level)
    walls = (edges.kind == Kind.ROOF) & (edges.partner >= 0)
    assert walls.sum() == 2
    assert (gaps[walls] > 3.0).all()
    np.testing.assert_allclose(gaps[edges.partner[walls]], -gaps[walls], rtol=0.1)
    assert (gaps[edges.partner < 0] == 0.0).all()


def test_points_and_their_positions_belong_to_what_is_in_view_of_an_edge() -> None:
    """A roof ten images long that only two parallel edges of are in view, and one that is wholly in view next to it."""
    eye = eyes(RIG)[0]
    long = Landmark.of("long", [(-300.0, -6.0), (-300.0, 6.0), (310.0, 6.0), (310.0, -6.0)], 0.0, 0.0)
    level, p = np.eye(3), np.array([0.0, 0.0, -40.0])
    edges = visible_edges([long], eye.pose(p, level)[0])
    samples = sample_edges(edges, eye, p, level, 8.0, 100)
    position, axes = eye.pose(p, level)
    px = CAMERA.project((samples.points_n - position) @ axes)
    inside = CAMERA.contains(px)
    assert inside.mean() > 0.9
    counts = np.bincount(samples.edge)
    assert np.count_nonzero(counts) == 2
    assert counts.max() == pytest.approx(480 / 8.0, rel=0.15)
    for e in np.flatnonzero(counts):
        tau, t = samples.tau[samples.edge == e], samples.t[samples.edge == e]
        assert tau[0] == pytest.approx(-1.0, abs=0.05)
        assert tau[-1] == pytest.approx(1.0, abs=0.05)
        assert 0.4 < t.min() < t.max() < 0.6
    whole = sample_edges(visible_edges([MARK], eye.pose(P, R)[0]), eye, P, R, 10.0, 8)
    np.testing.assert_array_equal(whole.tau, 2.0 * whole.t - 1.0)
