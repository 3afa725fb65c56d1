"""Cramer-Rao bound of one view: every visible corner known to 0.5 px, map and rig as uncertain as they are, and the prior.

B = (H^T (s^2 I + N N^T)^-1 H + P_0^-1)^-1,   s = 0.5 px
"""

import numpy as np

from benchmarks.single_fix_views import View
from models.messages import Array
from vision.sensitivity import EdgeView, Eye, Samples, eyes, map_rows, pose_rows, rig_rows
from vision.visibility import ModelEdges, hidden, visible_edges

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
        for axis in range(2):
            seen = _along(corners, eye, view, axis)
            sigma = np.array([[m.sigma_m, m.sigma_m, m.height_sigma_m, m.outline_sigma_m] for m in view.landmarks])
            mapped = map_rows(seen, corners, edges, eye, view.p_n, view.R_nb, len(marks)) * sigma.ravel()
            bc, rc, own = rig_rows(seen, eye, rig)
            zero = np.zeros_like(own)
            own = own * np.sqrt(np.diag(eye.camera.covariance))
            halves = [zero, own] if eye.right else [own, zero]
            rig_part = [bc * np.sqrt(np.diag(rig.covariance_bc)), rc * np.sqrt(np.diag(rig.covariance_rc))]
            A.append(pose_rows(seen, corners, eye, view.p_n, view.R_nb)[shown])
            nuisances.append(np.hstack([mapped, *rig_part, *halves])[shown])
    J = np.hstack((np.vstack(A), np.vstack(nuisances))) / CORNER_PX
    omega = J.T @ J + np.eye(J.shape[1])
    omega[:6, :6] += np.linalg.inv(view.prior.covariance) - np.eye(6)
    result: Array = np.linalg.inv(omega)[:6, :6]
    return result


def _corners(edges: ModelEdges) -> Samples:
    """Ends of all visible edges, each once."""
    count = len(edges.kind)
    points = np.concatenate((edges.start_n, edges.end_n))
    _, first = np.unique(np.round(points, 6), axis=0, return_index=True)
    return Samples(points[first], (first >= count).astype(float), first % count)


def _shown(corners: Samples, eye: Eye, view: View) -> np.ndarray:
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
