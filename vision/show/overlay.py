"""The map drawn into an image, and outline residuals [px]."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from models.camera import CameraModel
from models.maps.landmarks import Landmark
from models.messages import Array
from vision.outline.visibility import Kind, hidden, visible_edges

Canvas = NDArray[np.uint8]
Bgr = tuple[int, int, int]

IDENTIFIED: Bgr = (90, 230, 80)  # green
MAPPED: Bgr = (60, 190, 255)  # amber: in the map, not used
RESIDUAL: Bgr = (255, 90, 255)  # magenta
_DARK: Bgr = (25, 25, 25)
_WHITE: Bgr = (255, 255, 255)
_SHIFT = 4  # binary digits of a pixel that OpenCV's lines know
_PIECES = 32  # of an edge, so that it bends with the lens
_REACH_PX, _STEP_PX = 6.0, 0.5  # how far edges are searched for, and how finely
_NEARER = 2.0 / 3.0  # of the reach, 1 sigma: of two edges the nearer one counts more
_LEAST_SLOPE = 6.0  # grey values a pixel, that make an edge
_SPACING_PX = 4.0  # of the points on an edge, at least
_CORNER_PX = 4.0  # from a corner two edges are seen at once
_MAGNIFIED = 10.0  # residuals are drawn so much longer


@dataclass(frozen=True, slots=True)
class Residuals:
    """Points, unit normals (N, 2) of outlines, offset_px (N,) of the seen edge, NaN: none."""

    id: str
    px: Array
    normal: Array
    offset_px: Array

    @property
    def found(self) -> float:
        """Share of points with an edge."""
        return float(np.mean(np.isfinite(self.offset_px)))

    @property
    def spread_px(self) -> float:
        """1.4826 median |offset|, robust RMS; NaN without edges."""
        offsets = self.offset_px[np.isfinite(self.offset_px)]
        return 1.4826 * float(np.median(np.abs(offsets))) if len(offsets) else float("nan")


def outline_residuals(
    image: Canvas, camera: CameraModel, p_nc: Array, R_nc: Array, landmarks: Sequence[Landmark], reach_px: float = _REACH_PX
) -> list[Residuals]:
    """Residuals of roof outlines in an image (H, W) or (H, W, 3), within reach_px."""
    landmarks = in_view(camera, p_nc, R_nc, landmarks)
    edges = _edges(camera, p_nc, R_nc, landmarks)
    along = np.gradient(edges.px, axis=1) if len(edges.px) else edges.px
    along /= np.maximum(np.linalg.norm(along, axis=2, keepdims=True), 1e-9)
    normal = along[:, :, ::-1] * np.array([-1.0, 1.0])
    ends = np.stack([np.linalg.norm(edges.px - edges.px[:, [k]], axis=2) for k in (0, -1)]).min(axis=0)
    usable = edges.shown & (ends > _CORNER_PX) & (edges.kind == Kind.ROOF)[:, None]
    usable &= camera.contains(edges.px.reshape(-1, 2), reach_px + 2.0).reshape(usable.shape)
    length = np.nan_to_num(np.linalg.norm(edges.px[:, -1] - edges.px[:, 0], axis=1), nan=1.0)
    stride = np.ceil(_SPACING_PX * _PIECES / np.maximum(length, 1.0)).astype(np.int64)
    usable &= np.arange(edges.px.shape[1]) % stride[:, None] == 0
    owner = np.repeat(edges.landmark[:, None], edges.px.shape[1], axis=1)[usable]
    px, normal = edges.px[usable], normal[usable]
    offset = _edge_offsets(image, px, normal, reach_px)
    return [Residuals(landmarks[i].id, px[owner == i], normal[owner == i], offset[owner == i]) for i in np.unique(owner).tolist()]


def _edge_offsets(image: Canvas, px: Array, normal: Array, reach_px: float) -> Array:
    s = np.arange(-reach_px, reach_px + _STEP_PX, _STEP_PX)
    beside = normal[:, ::-1] * np.array([1.0, -1.0])
    positions = (
        px[:, None, None] + np.arange(-1.0, 2.0)[:, None, None] * beside[:, None, None] + s[:, None] * normal[:, None, None]
    )
    if len(px) == 0:
        return np.empty(0)
    u, v = np.moveaxis(positions.reshape(len(px), -1, 2), 2, 0).astype(np.float32)
    values = cv2.remap(image.astype(np.float32), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    profile = values.reshape(len(px), 3, len(s), -1).mean(axis=1)
    slope = np.linalg.norm(profile[:, 2:] - profile[:, :-2], axis=2) / (2.0 * _STEP_PX)
    at = s[1:-1]
    best = np.argmax(slope * np.exp(-0.5 * (at / (_NEARER * reach_px)) ** 2), axis=1)
    inside = np.clip(best, 1, len(at) - 2)
    rows = np.arange(len(px))
    left, top, right = slope[rows, inside - 1], slope[rows, inside], slope[rows, inside + 1]
    bend = left - 2.0 * top + right
    beside_top = np.clip(0.5 * (left - right) / np.where(bend < 0.0, bend, 1.0), -0.5, 0.5)  # on a flank it would be far out
    summit = at[inside] + _STEP_PX * beside_top
    offsets: Array = np.where((best == inside) & (bend < 0.0) & (top >= _LEAST_SLOPE), summit, np.nan)
    return offsets


def expected_px(camera: CameraModel, p_n: Array, p_nc: Array, R_nc: Array, covariance: Array, landmark: Landmark) -> float:
    """sigma of a residual by pose and landmark; NaN for a hidden roof.

        du = J R_nc^T (-dp + [X - p_n]x dtheta + dX),   sigma^2 = tr(cov(du)) / 2

    covariance: (6, 6) of p_n and rotation about n; X: roof middle; J: of the projection.
    """
    lever = np.array([*landmark.centre_n, landmark.roof_d]) - p_n
    jacobian = camera.project_jacobian(((p_n + lever - p_nc) @ R_nc)[None])[0] @ R_nc.T
    cross = np.cross(lever, np.eye(3)).T
    rows = np.hstack((-jacobian, jacobian @ cross))
    own = np.array([landmark.sigma_m, landmark.sigma_m, landmark.height_sigma_m]) ** 2
    return float(np.sqrt(0.5 * np.trace(rows @ covariance @ rows.T + (jacobian * own) @ jacobian.T)))


def draw_overlay(
    image: Canvas,
    camera: CameraModel,
    p_nc: Array,
    R_nc: Array,
    landmarks: Sequence[Landmark],
    identified: Collection[str] = (),
    residuals: Sequence[Residuals] = (),
    caption: Sequence[str] = (),
) -> Canvas:
    """A copy (H, W, 3) with visible edges and names.

    residuals: strokes of ten times their length.
    """
    canvas: Canvas = np.array(image if image.ndim == 3 else np.repeat(image[:, :, None], 3, axis=2), order="C")
    scale = max(1.0, min(canvas.shape[:2]) / 480.0)
    landmarks = in_view(camera, p_nc, R_nc, landmarks)
    lines = _lines(camera, p_nc, R_nc, landmarks)
    used = [mark.id in identified for mark in landmarks]
    order = sorted(range(len(landmarks)), key=lambda i: used[i])  # identified ones on top
    for i in order:
        colour, width = (IDENTIFIED, 2.0) if used[i] else (MAPPED, 1.0)
        _draw_lines(canvas, lines[i], colour, width * scale)
    for residual in residuals:
        _draw_residuals(canvas, residual, scale)
    spread = {residual.id: residual.spread_px for residual in residuals if np.isfinite(residual.spread_px)}
    taken = _draw_caption(canvas, caption, scale)
    for i in reversed(order):
        text = landmarks[i].label + (f"  {spread[landmarks[i].id]:.2f} px" if landmarks[i].id in spread else "")
        _draw_name(canvas, text, lines[i], IDENTIFIED if used[i] else MAPPED, scale, taken)
    return canvas


def add_strip(canvas: Canvas, parts: Sequence[str]) -> Canvas:
    """The image (H, W, 3) with a text strip below; even size for videos."""
    height, width = canvas.shape[:2]
    size = max(11, round(14 * max(1.0, min(height, width) / 480.0)))
    while size > 8 and sum(_text_size(part, size)[0] for part in parts) > 0.95 * width:
        size -= 1
    framed = cv2.copyMakeBorder(canvas, 0, 2 * size + height % 2, 0, width % 2, cv2.BORDER_CONSTANT, value=_DARK)
    widths = [_text_size(part, size)[0] for part in parts]
    gap, left = max(0.0, width - sum(widths)) / max(1, len(parts)), 0.0
    for part, taken in zip(parts, widths, strict=True):
        cv2.putText(framed, part, (round(left + gap / 2), height + round(1.4 * size)), _WHITE, _font(), size, 500)
        left += gap + taken
    return np.asarray(framed, np.uint8)


def in_view(camera: CameraModel, p_nc: Array, R_nc: Array, landmarks: Sequence[Landmark]) -> list[Landmark]:
    """Landmarks whose bounding sphere reaches into the image."""
    corners = np.array(
        [[0.0, 0.0], [camera.width - 1.0, 0.0], [0.0, camera.height - 1.0], [camera.width - 1.0, camera.height - 1.0]]
    )
    widest = float(np.max(np.arccos(np.clip(np.nan_to_num(camera.ray(corners), nan=0.0)[:, 2], 0.0, 1.0))))
    kept = []
    for mark in landmarks:
        centre = np.array([*mark.centre_n, mark.base_d - mark.height_m / 2])
        radius = float(np.hypot(np.hypot(*(mark.outline_n - mark.centre_n).T).max(), mark.height_m / 2))
        offset_c = (centre - p_nc) @ R_nc
        distance = float(np.linalg.norm(offset_c))
        if distance <= radius or np.arccos(offset_c[2] / distance) - np.arcsin(radius / distance) <= widest:
            kept.append(mark)
    return kept


class _Edges(NamedTuple):
    """E edges of P points: landmark, kind (E,), px (E, P, 2), seen (E, P)."""

    landmark: NDArray[np.int64]
    kind: NDArray[np.int64]
    px: Array
    shown: NDArray[np.bool_]


def _edges(camera: CameraModel, p_nc: Array, R_nc: Array, landmarks: Sequence[Landmark]) -> _Edges:
    if not landmarks:
        return _Edges(
            np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, _PIECES + 1, 2)), np.empty((0, _PIECES + 1), bool)
        )
    edges = visible_edges(landmarks, p_nc)
    t = np.linspace(0.0, 1.0, _PIECES + 1)[:, None]
    points_n = edges.start_n[:, None] + t * (edges.end_n - edges.start_n)[:, None]
    flat = points_n.reshape(-1, 3)
    px = camera.project((flat - p_nc) @ R_nc)
    near = np.array([3.0 * camera.width, 3.0 * camera.height])
    with np.errstate(invalid="ignore"):
        shown = np.all(np.abs(px) < near, axis=1) & ~hidden(flat, p_nc, landmarks)
    return _Edges(edges.landmark, edges.kind, px.reshape(-1, len(t), 2), shown.reshape(-1, len(t)))


def _lines(camera: CameraModel, p_nc: Array, R_nc: Array, landmarks: Sequence[Landmark]) -> list[list[tuple[Kind, Array]]]:
    lines: list[list[tuple[Kind, Array]]] = [[] for _ in landmarks]
    for landmark, kind, px, shown in zip(*_edges(camera, p_nc, R_nc, landmarks), strict=True):
        breaks = np.flatnonzero(~shown)
        for part in np.split(np.arange(len(px)), np.unique(np.concatenate((breaks, breaks + 1)))):
            if len(part) > 1:
                lines[landmark].append((Kind(int(kind)), px[part]))
    return lines


def _draw_lines(canvas: Canvas, lines: list[tuple[Kind, Array]], colour: Bgr, width: float) -> None:
    for under in (True, False):
        for kind, px in lines:
            thick = max(1, round(width if kind == Kind.ROOF else width / 2)) + (2 if under else 0)
            cv2.polylines(canvas, [_fixed(px)], False, _DARK if under else colour, thick, cv2.LINE_AA, _SHIFT)


def _draw_residuals(canvas: Canvas, residual: Residuals, scale: float) -> None:
    found = np.abs(np.nan_to_num(residual.offset_px)) * _MAGNIFIED > 2.0 * scale  # shorter ones would hide the outline
    start = residual.px[found]
    end = start + _MAGNIFIED * residual.offset_px[found, None] * residual.normal[found]
    for a, b in zip(start, end, strict=True):
        cv2.line(canvas, _fixed(a).tolist(), _fixed(b).tolist(), RESIDUAL, max(1, round(scale)), cv2.LINE_AA, _SHIFT)


def _fixed(px: Array) -> NDArray[np.int32]:
    fixed: NDArray[np.int32] = np.rint(px * 2**_SHIFT).astype(np.int32)
    return fixed


@lru_cache(1)
def _font() -> "cv2.FontFace":
    return cv2.FontFace("sans")


def _text_size(text: str, size: int) -> tuple[int, int]:
    _, _, width, _ = cv2.getTextSize((10_000, 1000), text, (0, 0), _font(), size, 500)
    return width, round(1.25 * size)


def _write(canvas: Canvas, text: str, left: int, top: int, size: int, colour: Bgr) -> None:
    width, height = _text_size(text, size)
    pad = max(2, size // 4)
    ground = canvas[max(top, 0) : max(top + height + pad, 0), max(left - pad, 0) : max(left + width + pad, 0)]
    ground[:] = (0.35 * ground).astype(np.uint8)
    cv2.putText(canvas, text, (left, top + size), colour, _font(), size, 500)


def _draw_caption(canvas: Canvas, caption: Sequence[str], scale: float) -> list[tuple[int, int, int, int]]:
    size = round(14 * scale)
    boxes = []
    for k, text in enumerate(reversed(caption)):
        width, height = _text_size(text, size)
        top = canvas.shape[0] - (k + 1) * (height + round(5 * scale)) - round(4 * scale)
        _write(canvas, text, round(8 * scale), top, size, _WHITE)
        boxes.append((0, top, round(8 * scale) + width, top + height))
    return boxes


def _draw_name(
    canvas: Canvas, text: str, lines: list[tuple[Kind, Array]], colour: Bgr, scale: float, taken: list[tuple[int, int, int, int]]
) -> None:
    roof = [px for kind, px in lines if kind == Kind.ROOF]
    if not roof:
        return
    rows, columns = canvas.shape[:2]
    px = np.clip(np.concatenate(roof), 0.0, [columns - 1.0, rows - 1.0])
    low, high = px.min(axis=0), px.max(axis=0)
    if np.any(high - low < 2.0):  # only its border
        return
    size = round((14 if colour == IDENTIFIED else 12) * scale)
    width, height = _text_size(text, size)
    left_of, top_of = 0.5 * (low + high) - np.array([width / 2, height / 2])
    positions = [(left_of, top_of), (left_of, low[1] - height - 4 * scale), (left_of, high[1] + 4 * scale)]
    if high[0] - low[0] < width and high[1] - low[1] < 2 * height:
        positions[:1] = [(high[0] + 8 * scale, top_of), (low[0] - width - 8 * scale, top_of)]
    for u, v in positions:
        left, top = round(min(max(u, 4.0), columns - width - 4.0)), round(min(max(v, 2.0), rows - height - 4.0))
        box = (left, top, left + width, top + height)
        if all(box[2] < other[0] or other[2] < box[0] or box[3] < other[1] or other[3] < box[1] for other in taken):
            taken.append(box)
            _write(canvas, text, left, top, size, colour)
            return
