"""Views for the outline path: those of drawn_views, priors off by given pixels, decoys."""

import math
from dataclasses import replace

import numpy as np

from models import so3
from models.camera import CameraModel, StereoRig
from models.maps.landmarks import Landmark
from models.messages import Array
from models.prior import Prior
from tests.vision.predict.drawn_views import NADIR, Cell, View, draw_view
from vision.image.rectify import Image
from vision.pose.sensitivity import eyes
from vision.predict.motion import motion
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.ground import Ground
from vision.synthetic.render import render_pair
from vision.synthetic.shapes import rectangle
from vision.synthetic.texture import SURFACES
from vision.synthetic.world import Appearance, Solid, Sun, World

PRIOR_PX = 55.0  # 1 sigma of the shift: 3 sigma are the limit of the search
TURN_DEG, TILT_DEG, HEIGHT = 2.0, 0.5, 0.03  # 1 sigma; HEIGHT of the height above ground
_ON, _TURN_RAD = 0.03, 0.02  # 1 sigma, from one image to the next: of the height flown on, and turned
_SLIP_M, _SLIP_RAD = 0.03, 1e-3  # 1 sigma, by which dead reckoning errs over that


Pair = tuple[Image, Image]


def images_of(view: View) -> Pair:
    """Rendered."""
    return render_pair(view.world, view.true_rig, view.p_n, view.R_nb, view.conditions, view.rng)


def prior_of(view: View, sigma_px: float, off_px: float | None = None) -> Prior:
    """About the truth, drawn: the common shift of the outlines is known to sigma_px, as seen from the prior.

    off_px: how far they are shifted, in a direction that is drawn.
    """
    tilt, turn = math.radians(TILT_DEG), math.radians(TURN_DEG)
    root = np.diag([0.0, 0.0, HEIGHT * view.cell.height_m, tilt, tilt, turn])
    unit, direction = view.rng.normal(size=6), view.rng.uniform(0.0, 2.0 * math.pi)
    shift = (off_px or 0.0) * np.array([math.cos(direction), math.sin(direction)])
    error = root @ unit
    for _ in range(4):  # the prior's own view says how far a metre is
        J = _px_a_metre(view, _off(view, error, np.eye(6)))
        root[:2, :2] = sigma_px * np.linalg.inv(J[:, :2])
        error[:2] = root[:2, :2] @ unit[:2] if off_px is None else np.linalg.solve(J[:, :2], shift - J[:, 2:] @ error[2:])
    return _off(view, error, root @ root.T)


def _px_a_metre(view: View, prior: Prior) -> Array:
    """By how many px the outlines as a whole are shifted as the prior errs, (2, 6)."""
    about = motion(eyes(view.rig)[0], view.landmarks, prior)
    assert about is not None
    return about.J[:2]


def _off(view: View, error: Array, covariance: Array) -> Prior:
    """A prior that is off by an error (6,)."""
    q = so3.multiply(so3.quat_exp(-error[3:]), so3.from_matrix(np.ascontiguousarray(view.R_nb)))
    return Prior(view.p_n - error[:3], so3.normalise(q), covariance)


def later(view: View, prior: Prior) -> tuple[View, Pair, Prior]:
    """Half a second on: the view from there, its images, and the prior, which errs as before but for a slip."""
    rng = view.rng
    way, turn = rng.normal(size=3) * _ON * view.cell.height_m, so3.quat_exp(rng.normal(size=3) * _TURN_RAD)
    slip = np.array([_SLIP_M] * 3 + [_SLIP_RAD] * 3)
    error = rng.normal(size=6) * slip
    moved = replace(view, p_n=view.p_n + way, R_nb=so3.matrix(turn) @ view.R_nb)
    q = so3.normalise(so3.multiply(so3.quat_exp(error[3:]), so3.multiply(turn, prior.q_nb_wxyz)))
    return moved, images_of(moved), Prior(prior.p_n + way + error[:3], q, prior.covariance + np.diag(slip**2))


def decoy(seed: int, number: int, kind: str) -> tuple[View, Pair, Prior]:
    """A view whose map or prior is wrong (turned, shifted, gone or row), its images, and the prior."""
    view = _row(seed, number) if kind == "row" else draw_view(seed, number)
    prior = prior_of(view, PRIOR_PX)
    marks = view.landmarks
    if kind == "turned":
        marks = tuple(_turned(m, view.rng.uniform(0.45, 2.6), np.mean([m.centre_n for m in marks], axis=0)) for m in marks)
    elif kind == "shifted":
        angle, far = view.rng.uniform(0.0, 2.0 * math.pi), view.rng.uniform(300.0, 450.0) * view.cell.height_m / 600.0
        prior = Prior(prior.p_n + far * np.array([math.cos(angle), math.sin(angle), 0.0]), prior.q_nb_wxyz, prior.covariance)
    elif kind == "gone":  # something else stands or lies in its place
        view = replace(view, world=replace(view.world, landmarks=(), appearances=(), clutter=_instead(view)))
    elif kind == "row":
        along = 1.0 if view.rng.random() < 0.5 else -1.0
        prior = Prior(prior.p_n + along * np.array([0.0, _period(view), 0.0]), prior.q_nb_wxyz, prior.covariance)
    view = replace(view, landmarks=marks)
    return view, images_of(view), prior


def _turned(mark: Landmark, angle: float, about: Array) -> Landmark:
    c, s = math.cos(angle), math.sin(angle)
    outline = (mark.outline_n - about) @ np.array([[c, s], [-s, c]]) + about
    return Landmark.of(
        mark.id, outline, mark.base_d, mark.height_m, mark.colour_bgr, mark.sigma_m, mark.height_sigma_m, mark.outline_sigma_m
    )


def _instead(view: View) -> tuple[Solid, ...]:
    """Other houses where the map's ones stood: of another size, turned."""
    solids = []
    for mark in view.landmarks:
        size, angle = view.rng.uniform(0.5, 1.1) * mark.length_m, view.rng.uniform(0.3, 1.2) + mark.orientation_rad
        c, s = math.cos(angle), math.sin(angle)
        outline = rectangle(size, size * view.rng.uniform(0.4, 0.9)) @ np.array([[c, s], [-s, c]]) + np.array(mark.centre_n)
        b, g, r = view.rng.uniform(60.0, 200.0, 3).tolist()
        solids.append(
            Solid(outline, mark.base_d, mark.height_m, Appearance((b, g, r), texture=str(view.rng.choice(list(SURFACES[:3])))))
        )
    return tuple(solids)


def _period(view: View) -> float:
    return float(view.landmarks[1].centre_n[1] - view.landmarks[0].centre_n[1])


def _row(seed: int, number: int) -> View:
    """A row of equal houses that goes on beyond both borders of the image, seen from 40 to 80 m; the prior spans a period."""
    rng = np.random.default_rng([seed, number, 7])
    height = rng.uniform(40.0, 80.0)
    spacing, length = rng.uniform(0.11, 0.2) * height, 0.0
    length = 0.7 * spacing
    places = (np.arange(15) - 7) * spacing
    colour = (60, 70, 170) if rng.random() < 0.5 else (130, 140, 150)
    marks = tuple(
        Landmark.of(f"h{k}", rectangle(length, 0.8 * length) + np.array([0.0, e]), 0.0, 0.25 * length, colour)
        for k, e in enumerate(places)
    )
    appearance = Appearance(colour, texture="shingles", contrast=0.08)
    world = World(marks, (appearance,) * len(marks), (), Ground.procedural(rng), Sun(rng.uniform(-3.0, 3.0)))
    camera = CameraModel(640, 480, 600.0, 600.0, 319.5, 239.5)
    rig = StereoRig(camera, camera, np.eye(3), np.array([-0.3, 0.0, 0.0]), NADIR, np.zeros(3))
    cell = Cell(height, 0.0, len(marks), "painted", 0.0, "clean")
    p_n, R_nb = np.array([rng.uniform(-2.0, 2.0), rng.uniform(-0.5, 0.5) * spacing, -height]), np.eye(3)
    prior = Prior(p_n, so3.from_matrix(R_nb), np.eye(6))
    return View(cell, world, rig, p_n, R_nb, Conditions(), rig, marks, prior, rng)
