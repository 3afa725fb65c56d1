"""Cramer-Rao bound of one view: every visible corner known to 0.5 px, map and rig as uncertain as they are, and the prior.

B = (H^T (s^2 I + N N^T)^-1 H + P_0^-1)^-1,   s = 0.5 px
"""

import numpy as np
from numpy.typing import NDArray

from benchmarks.fixes.single_fix_views import View
from models.messages import Array
from vision.outline.visibility import ModelEdges, hidden, visible_edges
from vision.pose.sensitivity import EdgeView, Eye, Samples, derivatives, eyes

CORNER_PX = 0.5


def bound(view: View) -> Array:
    """Covariance (6, 6) that no unbiased estimate of this view beats, at the true pose and by the visible corners alone."""
    rig, marks = view.rig, view.world.landmarks
    A, nuisances = [], []
    for eye in eyes(rig):
        p_nk, _ = eye.pose(view.p_n, view.R_nb)
        edges = visible_edges(marks, p_nk)
        corners = _corners(edges)
        shown = _shown(corners, eye, view)
        sigma = np.array([[m.sigma_m, m.sigma_m, m.height_sigma_m, m.outline_sigma_m] for m in view.landmarks])
        mark = edges.landmark[corners.edge]
        for axis in range(2):
            seen = _along(corners, eye, view, axis)
            d = derivatives(edges, corners, seen, eye, rig, view.p_n, view.R_nb)
            mapped = np.zeros((len(mark), *sigma.shape))
            mapped[np.arange(len(mark)), mark] = d.mapped[:, :4] * sigma[mark]
            own, zero = d.own * _sigmas(eye.camera.covariance), np.zeros_like(d.own)
            halves = [zero, own] if eye.right else [own, zero]
            rig_part = [d.bc * _sigmas(rig.covariance_bc), d.rc * _sigmas(rig.covariance_rc)]
            A.append(d.pose[shown])
            nuisances.append(np.hstack([mapped.reshape(len(mark), -1), *rig_part, *halves])[shown])
    J = np.hstack((np.vstack(A), np.vstack(nuisances))) / CORNER_PX
    omega = J.T @ J + np.eye(J.shape[1])
    omega[:6, :6] += np.linalg.inv(view.prior.covariance) - np.eye(6)
    result: Array = np.linalg.inv(omega)[:6, :6].astype(np.float64)
    return result


def _sigmas(covariance: Array | None) -> Array | float:
    return 0.0 if covariance is None else np.sqrt(np.diag(covariance))


def _corners(edges: ModelEdges) -> Samples:
    """Ends of all visible edges, each once."""
    count = len(edges.kind)
    points = np.concatenate((edges.start_n, edges.end_n))
    _, first = np.unique(np.round(points, 6), axis=0, return_index=True)
    t = (first >= count).astype(float)
    return Samples(points[first], t, first % count, 2.0 * t - 1.0)


def _shown(corners: Samples, eye: Eye, view: View) -> NDArray[np.bool_]:
    p_nk, R_nk = eye.pose(view.p_n, view.R_nb)
    px = eye.camera.project((corners.points_n - p_nk) @ R_nk)
    return eye.camera.contains(px) & ~hidden(corners.points_n, p_nk, view.world.landmarks)


def _along(corners: Samples, eye: Eye, view: View, axis: int) -> EdgeView:
    """The corners as points measured along u or v."""
    p_nk, R_nk = eye.pose(view.p_n, view.R_nb)
    x_c = (corners.points_n - p_nk) @ R_nk
    normal = np.zeros((len(x_c), 2))
    normal[:, axis] = 1.0
    return EdgeView(
        eye.camera.project(x_c), normal, eye.camera.project_jacobian(x_c)[:, axis], x_c, np.ones(len(x_c), dtype=np.bool_)
    )
