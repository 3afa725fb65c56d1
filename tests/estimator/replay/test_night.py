"""A flight by night: what a thermal camera sends, and that vision finds landmarks in it whatever their polarity."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.recognition.recognisers import fused
from estimator.replay import flight_images
from logs.wire.images import decode_image
from logs.wire.schemas import COMPRESSED_IMAGE, IMAGE
from models import so3
from models.prior import Prior
from models.sim.scenario import simulate
from models.sim.scenario_file import loads
from vision.pipeline import LandmarkPipeline
from vision.synthetic.faces import View, visible_faces
from vision.synthetic.texture import SURFACES

TEXT = (Path(__file__).parents[3] / "examples/scenarios/night.toml").read_text()
SIGMA = np.array([2.0, 2.0, 1.5, *np.radians([0.5, 0.5, 2.0])])


def flight(sees: str) -> flight_images.Flight:
    plan = loads(TEXT.replace('sees = "thermal"', f'sees = "{sees}"').replace("duration_s = 80.0", "duration_s = 40.0"), "night")
    assert plan.cameras is not None
    return flight_images.plan(plan.cameras, simulate(plan, 0), 0)


@pytest.fixture(scope="module")
def night() -> flight_images.Flight:
    return flight("thermal")


def test_thermal_images_are_16_bit_over_the_wire(night: flight_images.Flight) -> None:
    left, _ = night.draw(40)
    assert left.schema == IMAGE
    image = decode_image(left.schema, left.data)
    assert image.dtype == np.uint16
    assert image.shape == (256, 320)
    assert 7000 <= image.min() < image.max() < 7000 + 4 * 3 * 255
    assert len(np.unique(image)) > 256


def test_a_grey_camera_sends_one_channel() -> None:
    left, _ = flight("grey").draw(40)
    assert left.schema == COMPRESSED_IMAGE
    image = decode_image(left.schema, left.data)
    assert image.dtype == np.uint8
    assert image.shape == (256, 320)


def test_roofs_are_colder_or_warmer_than_the_ground_and_nothing_casts_a_shadow(night: flight_images.Flight) -> None:
    levels = np.array([appearance.roof_bgr for appearance in night.scene.world.appearances])
    assert (np.ptp(levels, axis=1) == 0.0).all()
    assert 0.2 < (levels[:, 0] > 110.0).mean() < 0.7
    assert night.scene.world.sun.shadow == 1.0


def test_walls_are_drawn_a_little_warmer_than_the_ground(night: flight_images.Flight) -> None:
    """Warmth is given off, not reflected: lit as by day they would look as cold as a cold roof above them."""
    world, above_n = night.scene.world, np.array([0.0, 0.0, -60.0])
    view = View(above_n, np.eye(3), np.array([-1.0, 1.0, -1.0, 1.0]), 1.0)
    faces = visible_faces(world.columns, view, world.sun.direction_n, world.sun.ambient)
    solid = np.repeat(faces.solids, np.diff(faces.solid_offsets))
    walls = faces.colour[(solid < len(world.landmarks)) & (faces.texture == SURFACES.index("wall"))]
    assert len(walls) > 5
    assert (walls > 1.04 * 110.0).all()
    assert (walls < 1.26 * 110.0).all()


def test_landmarks_are_found_by_night(night: flight_images.Flight) -> None:
    """With a map of the day, from a prior that is off: most images give a fix, none far from the truth.

    Each prior has an error of its own, so no image knows of the one before.
    """
    assert any(m.colour_bgr is not None for m in night.scene.map)
    rng, off_m = np.random.default_rng(7), []
    for k in range(40, 72, 4):
        at = int(np.argmin(np.abs(night.truth.t_ns - night.t_ns[k])))
        p_n, error = night.truth.p_n[at], rng.normal(size=6) * SIGMA
        q = so3.multiply(so3.quat_exp(-error[3:]), so3.from_matrix(np.ascontiguousarray(night.truth.R_nb[at])))
        prior = Prior(p_n - error[:3], so3.normalise(q), np.diag(SIGMA**2))
        left, right = (decode_image(m.schema, m.data) for m in night.draw(k))
        pipeline = LandmarkPipeline(night.scene.rig_calibrated, night.scene.map)
        result = pipeline.process(left, right, int(night.t_ns[k]), prior)
        if result.fix is not None:
            off_m.append(float(np.linalg.norm(fused(prior, result.fix)[0] - p_n)))
    assert len(off_m) >= 5
    assert 0.0 < np.median(off_m) < 1.5
    assert max(off_m) < 3.0
