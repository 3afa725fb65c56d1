"""All outlines as one pattern: common shift at every turn and scale of the prior (docs/vision_aerial.md).

    q = J_uv dx + e,   e ~ N(0, s^2)        (shift [px] of the outlines' middle; the map's error is one for all of them)

A fit away from the summit, or with an equal rival, is refused; a distinct summit without fit is reported along its directions.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np

from models.camera import StereoRig
from models.maps.landmarks import Landmark
from models.messages import Array
from vision.identify.sightings import one_eyed
from vision.image.reduced import levels
from vision.outline.visibility import Prisms
from vision.pose.point_pose import PointConfig, Points, fit_points
from vision.pose.pose import PoseEstimate, difference
from vision.pose.sensitivity import Eye, eyes
from vision.predict.coarse_search import CoarseConfig, limit_px
from vision.predict.edge_points import chromas, edge_points
from vision.predict.joint_score import Summit, joint_score, summit
from vision.predict.motion import Motion
from vision.predict.verify import ONE_ALONE
from vision.records.images import Images
from vision.records.reports import Result, fix_of, pose_flaw

NAME = "(outlines)"  # all of them count as one landmark, as wrong on the map as one of them is
_ROOF_PX = 32.0  # wider roofs are fitted edge by edge
_WIDEST_PX, _NARROWEST_PX = 48.0, 8.0  # of the roofs in the reduced image that is searched
_SEVERAL = 3  # outlines, where turn and scale are searched too; there a fit to more than
_HALF = 0.5  # of those in view, if they are as wide, needs no pattern beside it
_MOST = 300_000  # positions, turns and scales that are tried
_STIFF_PX = 3.0  # what turn and scale may move the outlines' ends: as much as an edge is wide
_APART_PX = 8.0  # nearer positions are one, as for the window of a fit
_AROUND_PX = 5.0 * _APART_PX  # searched all around, at least: positions that the prior excludes still sample chance
_POSITION = 1.0  # pixel of the searched image: how well the summit's position is known
_POINTS, _FEWER = 400, 240  # on the outlines; where turn and scale are searched too
_FLOOR = 0.5  # of the image's median gradient: below it there is no direction
SURE = 1.5  # of a summit alone
_LIKELY = 1.08  # of one where a fit is, as in registration.py
_ALONE = PointConfig(least=1, freedom=1e9, expected=1.0)  # one point has no residual that could tell of its noise


def judged(
    result: Result,
    rig: StereoRig,
    images: Images,
    marks: Sequence[Landmark],
    move: Motion,
    config: CoarseConfig,
    *,
    alone: bool = True,
) -> Result:
    """The result checked against the pattern; alone: one landmark may be a fix."""
    eye = eyes(rig)[int(images.only_right)]
    narrow = _only_shifts(move, config) and config.sigmas * move.shift_px <= limit_px(eye.camera, config)
    many = result.fix is not None and len(result.fix.landmarks) > _HALF * len(result.regions)
    trusted = many and move.roof_px >= _ROOF_PX  # sides of a dozen pixels lie on edges of something else in any dense quarter
    pair = images.left is not None and images.right is not None  # it has more to say: an exchange, disparities
    if not narrow and (trusted or pair or len(marks) < _SEVERAL):
        return result
    fitted = None if result.pose is None else _moved(result.pose, move)
    best = best_shift(eye, images, marks, move, config, None if fitted is None else fitted[2:])
    if isinstance(best, str):
        remark = f"{result.report.detail}; {best}" if best and result.fix is None else result.report.detail
        return replace(result, report=msgspec.structs.replace(result.report, detail=remark))
    if fitted is None:
        sure = best.ratio >= SURE and best.least >= _LIKELY
        return _as_fix(result, one_eyed(rig, right=images.only_right), marks, move, best, alone=alone) if sure else result
    off_px = float(np.linalg.norm(fitted[:2] - best.q[:2]))
    if off_px > _APART_PX * best.step_px:
        return refused(result, "no_pose", f"all outlines together lie {off_px:.0f} px from the fit")
    if best.ratio < _LIKELY:
        return refused(result, "ambiguous", f"all outlines together lie {1.0 / best.ratio:.0%} as well elsewhere")
    return result


def _moved(pose: PoseEstimate, move: Motion) -> Array:
    return move.J @ difference(pose.joint_p_n, pose.joint_R_nb, move.prior.p_n, move.prior.q_nb_wxyz)


def _only_shifts(move: Motion, config: CoarseConfig) -> bool:
    ends_px = config.sigmas * max(move.turn_rad, move.log_scale) * move.radius
    return move.roof_px < _ROOF_PX and ends_px <= _STIFF_PX


def best_shift(
    eye: Eye, images: Images, marks: Sequence[Landmark], move: Motion, config: CoarseConfig, fitted: Array | None = None
) -> Summit | str:
    """Likeliest shift, turn and scale, or the reason; empty with nothing in view.

    fitted (2,): turn and log scale of a fit, searched alone where all are too many.
    """
    image = images.right if images.only_right else images.left
    assert image is not None
    found = _grid(move, config, fitted)
    if isinstance(found, str):
        return found
    size, turned, su, sv = found
    level = levels(image, eye.camera, (size,))[0]
    straight, pose = Eye(level.camera, eye.R_kb, eye.p_bk, eye.right), move.pose(np.zeros(6))
    reach = max(su[-1], sv[-1]) / size
    seen = edge_points(straight, Prisms.of(marks), chromas(marks), pose, float(reach), _POINTS if len(turned) == 1 else _FEWER)
    if seen is None:
        return ""
    c, floor, apart = level.camera, _FLOOR * level.typical() + 0.5, _APART_PX * size

    def scores(turn: Array, each: bool = False) -> list[Array]:
        aimed = seen.aimed(straight, move.pose(move.gain[:, 2:] @ turn), move.gain[:, :2])
        field = level.field(aimed, (float(su[0]), float(su[-1])), (float(sv[0]), float(sv[-1])))
        camera = np.array([c.fx, c.fy, c.cx, c.cy])
        some = [aimed[seen.mark_of_point == mark] for mark in np.unique(seen.mark_of_point)] if each else [aimed]
        return [len(one) / len(aimed) * joint_score(field, camera, one, floor, su, sv) for one in some]

    best = summit(np.array([scores(turn)[0] for turn in turned]), turned, su, sv, move.covariance, apart)
    if len(turned) == 1 or best.ratio < SURE:
        return best
    singly = np.array(scores(best.q[2:], each=True))
    without = [summit((singly.sum(axis=0) - one)[None], best.q[None, 2:], su, sv, move.covariance, apart) for one in singly]
    moved = [float(np.linalg.norm(one.q[:2] - best.q[:2])) > apart for one in without]
    return replace(best, least=0.0 if any(moved) else min(one.ratio for one in without))


def _grid(move: Motion, config: CoarseConfig, fitted: Array | None) -> tuple[int, Array, Array, Array] | str:
    """Reduction, turns and log scales (T, 2), shifts u (U,), v (V,) [px], or the reason.

    Neighbours differ by _STIFF_PX at the ends; the image is reduced until roofs are narrow.
    """
    size = 1
    while move.roof_px / size > _WIDEST_PX:
        size *= 2
    while True:
        step = _STIFF_PX * size / move.radius
        counts = [int(config.sigmas * sigma / step) for sigma in (move.turn_rad, move.log_scale)]
        turns, scales = (step * np.arange(-n, n + 1.0) for n in counts)
        turned = np.array([(t, s) for t in turns for s in scales])
        reach = np.maximum(config.sigmas * np.sqrt(np.diag(move.covariance)[:2]), _AROUND_PX * size)
        su, sv = (size * np.arange(-n, n + 1.0) for n in np.ceil(reach / size).astype(int))
        if len(turned) * len(su) * len(sv) <= _MOST:
            return size, turned, su, sv
        if move.roof_px / (2 * size) < _NARROWEST_PX:
            if fitted is not None:
                return size, fitted[None], su, sv
            most = max(_MOST / (len(scales) * len(su) * len(sv)) - 1.0, 0.0) * step / (2.0 * config.sigmas)
            return (
                f"all outlines together not searched: heading open by {math.degrees(move.turn_rad):.1f} deg (1 sigma), with this "
                f"open position and height searched up to {math.degrees(most):.1f}"
            )
        size *= 2


def _as_fix(result: Result, rig: StereoRig, marks: Sequence[Landmark], move: Motion, best: Summit, *, alone: bool) -> Result:
    p_nc, R_nc = rig.camera_pose(*move.pose(move.gain @ best.q))
    bodies = Prisms.of(marks)
    roofs = bodies.roofs
    inside = rig.left.contains(rig.left.project((roofs - p_nc) @ R_nc))
    if not alone and np.logical_or.reduceat(inside, bodies.offsets[:-1]).sum() <= 1:
        return refused(result, "ambiguous", ONE_ALONE)
    middle = roofs[inside if inside.any() else ...].mean(axis=0, keepdims=True)
    noise_px = _POSITION * best.step_px
    point = Points(middle, rig.left.project((middle - p_nc) @ R_nc), np.eye(2)[None] * noise_px**2)
    variance = np.mean([(mark.sigma_m**2, mark.height_sigma_m**2) for mark in marks], axis=0)
    sigma = math.sqrt(variance[0]), math.sqrt(variance[1]), 0.0
    found = fit_points(rig, point, move.pose(np.zeros(6)), move.prior, sigma, _ALONE)
    if isinstance(found, str):
        return result
    pose, t_ns = found.estimate, result.report.t_ns
    if flaw := pose_flaw(pose, move.prior):
        return refused(result, "no_pose", flaw)
    single = result.report.detail.removeprefix("predicted: ")
    detail = (
        f"predicted: all {len(marks)} outlines together have one position, {best.ratio:.2f} times the second; singly {single}"
    )
    report = msgspec.structs.replace(result.report, outcome="fixed", detail=detail, residual_px=pose.residual_px)
    return Result(fix_of(pose, t_ns, (NAME,), min(best.score, 1.0)), report, result.regions, pose)


def refused(result: Result, outcome: str, detail: str) -> Result:
    """The result without its fix."""
    report = msgspec.structs.replace(result.report, outcome=outcome, detail=f"predicted: {detail}")
    return replace(result, fix=None, pose=None, report=report)
