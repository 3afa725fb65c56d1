"""Covariance of edge lines from the scatter of their points (docs/vision_pose.md).

    V_ek = tau s_ek^2 (A^T W A)^-1 + S_ek,        V_e,lr = tau rho s_el s_er G_l^T G_r + rho_s (S_el S_er)^(1/2)

s_ek: scatter of edge e in image k; tau = (1 + rho_1) / (1 - rho_1): correlation of neighbours; rho: of the same points in two
images; all shrunk towards usual values; S: common to an edge's points, floor + (c s)^2.
"""

from collections.abc import Sequence
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numba import njit
from numpy.typing import NDArray

from models.messages import Array
from vision.outline.edge_lines import EdgeLines
from vision.outline.visibility import Kind

Indices = NDArray[np.int64]
_BASE, _UPRIGHT, _SMALL = int(Kind.BASE), int(Kind.UPRIGHT), int(Kind.SMALL)
_BASE_TILT = 0.3  # of the further offset of base edges, as a tilt
_TRUSTED = 0.3  # weight from which a point counts for correlations


class NoiseConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The prior of edge noise, and for how many points it counts."""

    offset_px: Annotated[float, Meta(gt=0, description="common offset of an edge without scatter, 1 sigma")] = 0.03
    tilt_px: Annotated[float, Meta(gt=0, description="the same of its tilt, at the edge's ends")] = 0.02
    offset_share: Annotated[float, Meta(ge=0, description="common offset per scatter of the points")] = 0.5
    tilt_share: Annotated[float, Meta(ge=0, description="common tilt per scatter")] = 0.3
    base_px: Annotated[
        float, Meta(ge=0, description="further common offset of base edges (contact shade, what stands there)")
    ] = 0.3
    upright_px: Annotated[float, Meta(ge=0, description="further common offset and tilt of upright edges")] = 0.15
    spot_px: Annotated[
        float, Meta(ge=0, description="further common shift of a small landmark, each way (its shade, its shape)")
    ] = 0.3
    both: Annotated[float, Meta(ge=0, lt=1, description="share of these variances that is the same in both images")] = 0.9
    correlation: Annotated[float, Meta(ge=0, lt=1, description="of a point's error in the two images, beforehand")] = 0.5
    neighbours: Annotated[float, Meta(ge=0, lt=1, description="correlation of neighbouring points, beforehand")] = 0.25
    points: Annotated[float, Meta(gt=0, description="weight of these two, in points")] = 30.0
    edge_points: Annotated[float, Meta(gt=0, description="weight of the image's scatter in an edge's, in points")] = 8.0
    least_px: Annotated[float, Meta(gt=0, description="least scatter")] = 0.03


def line_covariance(lines: Sequence[EdgeLines], edge: Indices, kind: Indices, opened: Array, config: NoiseConfig) -> Array:
    """Covariance (E, K, 2, K, 2) px^2 of lines of E edges in K images.

    lines: of the same points in each; edge: (N,), points in order; kind: (E,) Kind; opened: (K, E) px^2 added to offsets.
    """
    c, images, edges = config, len(lines), len(kind)
    scatter = np.array([_scatter(one.square, one.points, c.edge_points, c.least_px) for one in lines])
    inflation = _inflation(lines, edge, scatter, config)
    floors, shares = (c.offset_px, c.tilt_px), (c.offset_share, c.tilt_share)
    common = [
        _common(s, kind, o, floors, shares, (c.base_px, c.upright_px, c.spot_px)) for s, o in zip(scatter, opened, strict=True)
    ]
    covariance = np.zeros((edges, images, 2, images, 2))
    for k, one in enumerate(lines):
        covariance[:, k, :, k] = _filled(inflation * scatter[k] ** 2, one.unit, common[k])
    if images == 2:
        rho, shared = _correlation(lines[0], lines[1], edge, scatter, config), _shared(lines[0].gain, lines[1].gain, edge, edges)
        both = c.both * np.sqrt(common[0] * common[1])
        between = _filled(inflation * rho * scatter[0] * scatter[1], shared, both)
        covariance[:, 0, :, 1], covariance[:, 1, :, 0] = between, between.transpose(0, 2, 1)
    return covariance


def _filled(white: Array, unit: Array, common: Array) -> Array:
    """covariance_e = white_e unit_e + diag(common_e): (E, 2, 2) of (E,), (E, 2, 2), (E, 2)."""
    covariance: Array = white[:, None, None] * unit
    covariance[:, [0, 1], [0, 1]] += common
    return covariance


@njit(cache=True)
def _common(
    scatter: Array, kind: Indices, opened: Array, floors: tuple[float, float], shares: tuple[float, float],
    further: tuple[float, float, float],
) -> Array:  # fmt: skip
    """Variances (E, 2) of offset and tilt common to an edge; further: feet, wall corners, small landmarks."""
    base_px, upright_px, spot_px = further
    common = np.empty((len(scatter), 2))
    for e in range(len(scatter)):
        for k in range(2):
            number = 0 if kind[e] == _SMALL else k  # both of a small landmark's are offsets
            common[e, k] = floors[number] ** 2 + (shares[number] * scatter[e]) ** 2
            if kind[e] == _BASE:
                common[e, k] += ((1.0, _BASE_TILT)[k] * base_px) ** 2
            elif kind[e] == _UPRIGHT:
                common[e, k] += upright_px**2
            elif kind[e] == _SMALL:
                common[e, k] += spot_px**2
        common[e, 0] += opened[e]
    return common


def _scatter(square: Array, points: Array, edge_points: float, least_px: float) -> Array:
    """s_ek (E,): (nu s_k^2 + SS) / (nu + n - 2), s_k^2 the image's mean."""
    freedom = np.maximum(points - 2.0, 0.0)
    total = square.sum() / max(freedom.sum(), 1.0)
    scatter: Array = np.sqrt(np.maximum((edge_points * total + square) / (edge_points + freedom), least_px**2))
    return scatter


def _inflation(lines: Sequence[EdgeLines], edge: Indices, scatter: Array, config: NoiseConfig) -> float:
    """tau of the pooled neighbour correlation, corrected by 2 / n for the fit."""
    product, square = config.points * config.neighbours, config.points
    for one, s in zip(lines, scatter, strict=True):
        own = _neighbours(one.residual, one.weight, one.points, edge, s)
        product, square = product + own[0], square + own[1]
    rho = min(max(product / square, 0.0), 0.8)
    return (1.0 + rho) / (1.0 - rho)


@njit(cache=True)
def _neighbours(residual: Array, weight: Array, points: Array, edge: Indices, scatter: Array) -> tuple[float, float]:
    """Sums of z_i z_i+1 + 2 / n and (z_i^2 + z_i+1^2) / 2 over neighbours, z = residual / scatter."""
    product = square = 0.0
    for i in range(1, len(edge)):
        e = edge[i]
        if edge[i - 1] == e and weight[i] > _TRUSTED and weight[i - 1] > _TRUSTED:
            before, here = residual[i - 1] / scatter[e], residual[i] / scatter[e]
            product += before * here + 2.0 / max(points[e], 3.0)
            square += 0.5 * (before * before + here * here)
    return product, square


@njit(cache=True)
def _shared(left: Array, right: Array, edge: Indices, edges: int) -> Array:
    total = np.zeros((edges, 2, 2))
    for i in range(len(edge)):
        for a in range(2):
            for b in range(2):
                total[edge[i], a, b] += left[i, a] * right[i, b]
    return total


def _correlation(left: EdgeLines, right: EdgeLines, edge: Indices, scatter: Array, config: NoiseConfig) -> float:
    product, square = _together(left.residual, left.weight, right.residual, right.weight, edge, scatter)
    rho = (product + config.points * config.correlation) / (square + config.points)
    return min(max(rho, 0.0), 0.95)


@njit(cache=True)
def _together(
    left: Array, left_weight: Array, right: Array, right_weight: Array, edge: Indices, scatter: Array
) -> tuple[float, float]:
    """Sums of z_l z_r and (z_l^2 + z_r^2) / 2, z = residual / scatter, over points in both images."""
    product = square = 0.0
    for i in range(len(edge)):
        if left_weight[i] > _TRUSTED and right_weight[i] > _TRUSTED:
            a, b = left[i] / scatter[0, edge[i]], right[i] / scatter[1, edge[i]]
            product += a * b
            square += 0.5 * (a * a + b * b)
    return product, square
