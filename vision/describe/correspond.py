"""Correspondence: the left image's region in the right one (thesis sections 4.3.2, 4.5 and 5.4).

    coarse   Sobel edges of a reduced image, normalised correlation coefficient along the epipolar line (eq. 4.64, 4.80),
             the region's own pixels and a rim, left to right and back
    fine     in cells, by Gauss-Newton on  I_r(u - d, v) = g I_l(u, v) + o,  with the variance from the remainder

Rectified, grey, uint8 or uint16.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.camera import StereoRig
from models.messages import Array
from vision.describe import correlation
from vision.describe.plane import DisparityPlane, fit_plane
from vision.describe.regions import Region
from vision.image.rectify import Image

Pixels = NDArray[np.int32]  # (N, 2) u, v
_SQUARE = np.ones((5, 5), np.uint8)  # taken off a region's inside: half an edge has the gradient of an edge, but not its position
_RIM = 2  # px around a region that belong to it: its edges are what can be matched


@dataclass(frozen=True, slots=True)
class Search:
    """How far and how strictly correspondences are sought."""

    nearest_m: float = 4.0  # nothing is nearer than this
    clear_score: float = 0.55  # of the correlation coefficient of the edges
    clear_lead: float = 0.02  # over the next best position, of a clear score
    weak_score: float = 0.40  # reflections, other light: enough where no other position is like it
    weak_lead: float = 0.20
    vertical_px: int = 6  # how far from its row a match is sought, to notice that rows do not fit
    template_px: int = 350  # pixels of a template at the coarse level
    cells: int = 24  # of a region, about
    slope_tangent: float = 0.3  # sigma of the surfaces' tilt against the image plane, tan
    noise_floor: float = 0.7  # levels: 8-bit quantisation and a little more
    rim_sigma_px: float = 0.08  # what the ground beside a region does to the disparity of a cell at its edge


@dataclass(frozen=True, slots=True)
class Match:
    """A region in the right image; disparity = u_l - u_r.

    points (M, 2), disparities, sigmas (M,): cells [px]; plane: through them; score: coarse correlation; vertical_px: v_r - v_l.
    """

    region: Region
    points: Array
    disparities: Array
    sigmas: Array
    plane: DisparityPlane
    score: float
    vertical_px: float
    vertical_sigma_px: float


@dataclass(frozen=True, slots=True)
class Unmatched:
    """A region without match, and why; behind: matched on the side of swapped images."""

    region: Region
    reason: str
    behind: bool = False


def correspond(
    left: Image, right: Image, regions: Sequence[Region], rig: StereoRig, search: Search | None = None
) -> list[Match | Unmatched]:
    """A Match or Unmatched per region; left, right: rectified, grey."""
    search = search or Search()
    pair = _Pyramid(left, right)
    return [_match(pair, region, rig, search) for region in regions]


def disparity_offset(rig: StereoRig) -> float:
    """u_l - u_r at infinity: cx_l - cx_r."""
    return rig.left.cx - rig.right.cx


class _Pyramid:
    def __init__(self, left: Image, right: Image) -> None:
        self._grey = [(np.ascontiguousarray(left), np.ascontiguousarray(right))]
        self._edges: dict[int, tuple[NDArray[np.float32], NDArray[np.float32]]] = {}

    def grey(self, level: int) -> tuple[Image, Image]:
        while len(self._grey) <= level:
            left, right = self._grey[-1]
            self._grey.append((cv2.pyrDown(left), cv2.pyrDown(right)))
        return self._grey[level]

    def edges(self, level: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        if level not in self._edges:
            left, right = self.grey(level)
            self._edges[level] = sobel(left), sobel(right)
        return self._edges[level]


def sobel(grey: Image) -> NDArray[np.float32]:
    """G = sqrt(GX^2 + GY^2) (thesis eq. 4.62-4.64)."""
    gx, gy = cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)
    return np.asarray(cv2.magnitude(gx, gy), dtype=np.float32)


def _match(pair: _Pyramid, region: Region, rig: StereoRig, search: Search) -> Match | Unmatched:
    offset = disparity_offset(rig)
    reach = rig.left.fx * rig.baseline_m / search.nearest_m
    found = _coarse(pair, region, offset, reach, search)
    if isinstance(found, str):
        return Unmatched(region, found)
    disparity, score = found
    rim = correlation.template(region.mask, region.bbox[0], region.bbox[1], 0, _RIM)
    position = _to_the_pixel(pair, rim, disparity, search)
    if isinstance(position, str):
        return Unmatched(region, position)
    disparity, vertical = position
    if disparity - offset < -1.5:
        return Unmatched(region, f"disparity {disparity - offset:.1f} px: behind the camera", behind=True)
    gain = correlation.gain(*pair.grey(0), rim, disparity, vertical)
    return _fine(pair, region, rig, search, (disparity, vertical, score, gain))


def _coarse(pair: _Pyramid, region: Region, offset: float, reach: float, search: Search) -> tuple[int, float] | str:
    level = 1
    while region.mask.sum() / 4**level > search.template_px and level < 4:
        level += 1
    pixels = correlation.template(region.mask, region.bbox[0], region.bbox[1], level, _RIM)
    left, right = pair.edges(level)
    size = 2**level
    low, high = int(np.floor((offset - reach) / size)), int(np.ceil((offset + reach) / size))
    scores = correlation.scan(left, right, pixels, low, high, 0)
    best = int(scores.argmax())
    others = np.where(np.abs(np.arange(len(scores)) - best) > 2, scores, -1.0)
    if flaw := _flaw(float(scores[best]), float(others.max()), search):
        return flaw
    shifted = pixels - np.array([low + best, 0], dtype=np.int32)
    back = correlation.scan(right, left, shifted, -(low + best) - 6, -(low + best) + 6, 0)
    if abs(int(back.argmax()) - 6) > 1:
        return "left-right check: the way back leads elsewhere"
    return (low + best) * size, float(scores[best])


def _to_the_pixel(pair: _Pyramid, rim: Pixels, disparity: int, search: Search) -> tuple[int, int] | str:
    left, right = pair.grey(0)
    some = rim[:: max(len(rim) // 900, 1)]
    vertical = 0
    for _ in range(2):  # along the row, across it, along it again where that led to another row
        scores = correlation.scan(left, right, some, disparity - 12, disparity + 12, vertical)
        best = int(scores.argmax())
        disparity += best - 12
        shifts = range(-search.vertical_px, search.vertical_px + 1)
        across = [correlation.scan(left, right, some, disparity, disparity, dv)[0] for dv in shifts]
        found = int(np.argmax(across)) - search.vertical_px
        if across[found + search.vertical_px] < across[vertical + search.vertical_px] + 0.01 or found == vertical:
            break
        vertical = found
    others = np.where(np.abs(np.arange(len(scores)) - best) > 2, scores, -1.0)
    peaks = others[1:-1][(others[1:-1] >= scores[:-2]) & (others[1:-1] >= scores[2:])]
    flaw = _flaw(float(scores[best]), float(peaks.max(initial=-1.0)), search)
    return flaw or (disparity, vertical)


def _flaw(score: float, second: float, search: Search) -> str:
    """Why the best position is no match, or empty."""
    if score < search.weak_score:
        return f"no match: best correlation {max(score, 0.0):.2f}"
    if score >= search.clear_score:
        return "ambiguous: two positions fit alike" if second > score - search.clear_lead else ""
    lead = f"{score - second:.2f} over the next, needed {search.weak_lead:g}"
    return f"no match: best correlation {score:.2f}, {lead}" if second > score - search.weak_lead else ""


def _fine(
    pair: _Pyramid, region: Region, rig: StereoRig, search: Search, start: tuple[int, int, float, float]
) -> Match | Unmatched:
    """Inside where textured, else with its edges, which the ground moves."""
    inside = cv2.erode(region.mask.view(np.uint8), _SQUARE, borderType=cv2.BORDER_CONSTANT, borderValue=0).view(np.bool_)
    match = _cells(pair, region, rig, search, start, (inside, 0, 0.0))
    if isinstance(match, Match) and match.plane.covariance[0, 0] < search.rim_sigma_px**2:
        return match
    with_edges = _cells(pair, region, rig, search, start, (correlation.padded(region.mask, _RIM), _RIM, search.rim_sigma_px))
    return with_edges if isinstance(with_edges, Match) else match


def _cells(
    pair: _Pyramid,
    region: Region,
    rig: StereoRig,
    search: Search,
    start: tuple[int, int, float, float],
    where: tuple[NDArray[np.bool_], int, float],
) -> Match | Unmatched:
    """Cells and their plane, twice: the second time along the first plane."""
    (disparity, vertical, score, gain), (mask, rim, blur) = start, where
    left, right = pair.grey(0)
    corner = (region.bbox[0] - rim, region.bbox[1] - rim)
    size = max(int(np.sqrt(mask.sum() / search.cells)), 8)
    slope_sigma = search.slope_tangent * max(disparity - disparity_offset(rig), 1.0) / rig.left.fx
    plane = DisparityPlane(np.zeros(2), np.array([disparity, 0.0, 0.0]), np.eye(3), 1.0, 0)
    for _ in range(2):
        guess = np.concatenate((plane.coefficients, plane.origin))
        cells, step, information = correlation.cells(left, right, mask, corner, size, guess, vertical, gain, search.noise_floor)
        sigmas = np.hypot(cells[:, 3], blur)
        fitted = fit_plane(cells[:, :2], cells[:, 2], sigmas, np.zeros(2), slope_sigma)
        if fitted is None:
            return Unmatched(region, "no texture that could be matched")
        plane = fitted
    if plane.used < 0.5 * len(cells) or plane.covariance[0, 0] > 1.0:
        return Unmatched(region, "no plane: the cells' disparities disagree")
    sigma = float(plane.scatter / np.sqrt(max(information, 1e-12)))
    return Match(region, cells[:, :2], cells[:, 2], sigmas, plane, score, vertical + step, sigma)
