"""Learned matching: drawn ground, a video over an orthophoto of another date, wrong maps, models that are not the ones meant."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from benchmarks.aerial import nust
from benchmarks.aerial.registration_sets import NEAR, nust_file
from benchmarks.aerial.trials import generator, nadir_rig
from estimator.map_files import image as image_store
from models import so3
from models.camera import StereoRig
from models.prior import Prior
from tests.vision.ground import scene
from vision.ground.features import NotRecognised, Recognised
from vision.ground.image import GroundImage
from vision.ground.learned import Learned, Model, ModelError, recognise_learned
from vision.records.reports import pose_flaw

SIGMA = np.array([8.0, 8.0, 3.0, 0.01, 0.01, 0.03])
NAMES = "xfeat_1024_640x360.onnx", "lighterglue_L3.onnx"
SHA256 = (
    "1cedb09368994d8fe9721ce352f027537ec5179dde423728fe5aab71f52c99cd",
    "a721f366f54b20328fa98c799cc31478edb1c31f0c941528df3d363c3753760d",
)


@pytest.fixture(scope="module")
def files(landfix_data: Path) -> tuple[Path, Path]:
    extractor, matcher = (landfix_data / "models" / name for name in NAMES)
    if not extractor.is_file() or not matcher.is_file():
        pytest.skip(f"LANDFIX_DATA has no models/{NAMES[0]} and models/{NAMES[1]}")
    return extractor, matcher


@pytest.fixture(scope="module")
def models(files: tuple[Path, Path]) -> Learned:
    pytest.importorskip("onnxruntime", reason="landfix[learned] is not installed")
    extractor, matcher = (Model(path.name, path.read_bytes(), sha256) for path, sha256 in zip(files, SHA256, strict=True))
    return Learned(extractor, matcher)


def _found(
    models: Learned, seed: int, known: GroundImage, prior_yaw: float = 0.03
) -> tuple[Recognised | NotRecognised, Prior, float]:
    rng = np.random.default_rng(seed)
    p_n, R_nb, prior = scene.flight(rng, SIGMA)
    sigma = np.array([*SIGMA[:5], prior_yaw])
    prior = Prior(prior.p_n, prior.q_nb_wxyz, np.diag(sigma**2))
    found = recognise_learned(models, scene.RIG, scene.shot(scene.drawing(seed), p_n, R_nb, rng), prior, known)
    return found, prior, scene.chi_square(found.pose, p_n, R_nb) if isinstance(found, Recognised) else np.nan


def test_ground_that_is_known_is_found(models: Learned) -> None:
    found, prior, squared = _found(models, 1, scene.map_image(scene.drawing(1)))
    assert isinstance(found, Recognised), found
    assert not pose_flaw(found.pose, prior)
    assert squared < 33.7  # chi-square of 6, 1e-5


def test_near_a_position_the_map_is_as_fine_as_the_image(models: Learned) -> None:
    """From a wide prior the map's view is half as fine: fewer of the matches agree."""
    rng = np.random.default_rng(1)
    p_n, R_nb, _ = scene.flight(rng, SIGMA)
    prior = Prior(p_n, so3.from_matrix(R_nb), np.diag(np.array([40.0, 40.0, *SIGMA[2:]]) ** 2))
    image, known = scene.shot(scene.drawing(1), p_n, R_nb, rng), scene.map_image(scene.drawing(1))
    wide = recognise_learned(models, scene.RIG, image, prior, known)
    near = recognise_learned(models, scene.RIG, image, prior, known, (p_n, R_nb))
    assert isinstance(wide, Recognised), wide
    assert isinstance(near, Recognised), near
    assert near.inliers / near.matched > wide.inliers / wide.matched


@pytest.mark.long
def test_a_video_is_found_in_an_orthophoto_of_another_date_and_in_no_wrong_one(models: Learned, landfix_data: Path) -> None:
    """The map turned by half a turn, mirrored, and 200 m aside."""
    landmarks, registered, rig = nust.landmark_map(), nust.registrations(landfix_data), nadir_rig(nust.camera())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(image_store, "keypoints", lambda *_: (np.empty((0, 2)), np.empty((0, 128), np.uint8)))
        known = image_store.load(nust_file(landfix_data), landmarks.origin).image
    wrong = known.image[::-1, ::-1], known.image[:, ::-1], np.roll(known.image, 400, 1)
    for number, image in nust.frames(landfix_data, (0, 60)):
        p_nc, R_nc = nust.pose(registered[number], landmarks)
        prior = NEAR.draw(generator(1, "learned", number), p_nc, R_nc @ rig.R_bc.T)
        found = recognise_learned(models, rig, image, prior, known)
        assert isinstance(found, Recognised), found
        assert not pose_flaw(found.pose, prior)
        off = found.pose.joint_p_n - p_nc
        assert off @ np.linalg.solve(found.pose.joint_covariance[:3, :3], off) < 16.3  # chi-square of 3, 1e-3
        for other in wrong:
            false = recognise_learned(models, rig, image, prior, replace(known, image=np.ascontiguousarray(other)))
            assert isinstance(false, NotRecognised) or pose_flaw(false.pose, prior)


def test_a_camera_that_is_upright_is_not_turned(models: Learned) -> None:
    """The extractor's input is upright: a wide image is turned by a quarter, a high one is not."""
    rng = np.random.default_rng(1)
    high = _upright()
    p_n, R_nb, prior = scene.flight(rng, SIGMA)
    seen = scene.shot(scene.drawing(1), p_n, R_nb, rng)[:, 140:500]
    found = recognise_learned(models, high, seen, prior, scene.map_image(scene.drawing(1)))
    assert isinstance(found, Recognised), found
    assert scene.chi_square(found.pose, p_n, R_nb) < 33.7


def _upright() -> StereoRig:
    """The middle 360 columns of the camera."""
    cut = msgspec.structs.replace(scene.CAMERA, width=360, cx=scene.CAMERA.cx - 140.0)
    rig: StereoRig = msgspec.structs.replace(scene.RIG, left=cut)
    return rig


def test_a_heading_too_open_is_said(models: Learned) -> None:
    found, _, _ = _found(models, 1, scene.map_image(scene.drawing(1)), prior_yaw=0.3)
    assert isinstance(found, NotRecognised)
    assert "heading open by 17 deg" in found.detail


def test_another_file_is_refused_in_one_line(files: tuple[Path, Path]) -> None:
    extractor, matcher = (Model(path.name, path.read_bytes()) for path in files)
    with pytest.raises(ModelError, match="SHA-256"):
        Learned(extractor._replace(sha256="0" * 64), matcher)
    pytest.importorskip("onnxruntime", reason="landfix[learned] is not installed")
    with pytest.raises(ModelError, match="not the model that is needed here"):
        Learned(matcher, extractor)
    with pytest.raises(ModelError, match="not an ONNX model"):
        Learned(extractor._replace(content=extractor.content[:1000]), matcher)
