"""A map that holds an image, from the configuration to the fix: in a replay, again to the bit, and by landfix locate."""

import json
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from calib.files.formats import save_rig
from estimator.cli import app
from estimator.config import Config, ConfigError, load
from estimator.service.run import _metadata
from estimator.tools.doctor.machine import configuration
from logs.store.reader import LogReader, Record
from logs.store.recorder import Recorder
from logs.wire.codec import Decoder, decode_odometry, encode_input
from logs.wire.images import encode_image
from models.messages import LandmarkFix, PoseFix
from models.sim.scenario import EPOCH_NS
from tests.estimator.map_files.image_files import ORIGIN, UTM, write
from tests.estimator.scenes import SECOND, hover
from tests.vision.ground import scene

PLACE = (20.0, -15.0, -110.0)
SEEN_S = (6.0, 6.5, 7.0, 7.5)
LOOKS = len(SEEN_S) - 1  # the last image waits for the other camera's till the end
ALIGNED_S = 5.0


def _records(path: Path, *topics: str) -> list[Record]:
    with LogReader(path) as reader:
        return [record for record in reader if record.topic in topics]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """ortho.png, rig.yaml, flight.toml, flight.mcap: aligned by pose fixes, then images of one camera only."""
    out, rng, ground = tmp_path_factory.mktemp("image"), np.random.default_rng(0), scene.drawing(1)
    write(scene.map_image(ground), out / "ortho.png")
    save_rig(out / "rig.yaml", scene.RIG)
    origin = ", ".join(map(str, ORIGIN))
    (out / "flight.toml").write_text(
        f'[map]\norigin = [{origin}]\npicture = "ortho.png"\npicture_epsg = {UTM}\npicture_sigma_m = 0.2\n'
        'picture_height_m = 488.0\n[rig]\nfile = "rig.yaml"\n[pose_fix]\ntilt_deg = 0.0\nmount_deg = 0.0\n'
    )
    last_ns = EPOCH_NS + round(ALIGNED_S * SECOND)
    messages = [
        (m.arrived_ns, encode_input(m)) for m in hover(9.0, place=PLACE) if not (isinstance(m, PoseFix) and m.t_ns > last_ns)
    ]
    for seen_s in SEEN_S:
        t_ns = EPOCH_NS + round(seen_s * SECOND)
        image = scene.shot(ground, np.array(PLACE), np.eye(3), rng)
        messages.append((t_ns + SECOND // 50, encode_image(t_ns, image, "/left/image")))
    cv2.imwrite(str(out / "left.png"), image)
    with Recorder(out / "flight.mcap") as recorder:
        for arrived_ns, message in sorted(messages, key=lambda item: item[0]):
            recorder.write(*message, arrived_ns)
    return out


def _replay(folder: Path, source: Path, out: Path) -> str:
    arguments = ["replay", str(source), "-o", str(out), "-c", str(folder / "flight.toml"), "--from-images"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture(scope="module")
def seen(folder: Path) -> Path:
    _replay(folder, folder / "flight.mcap", folder / "seen.mcap")
    return folder / "seen.mcap"


def test_fixes_come_from_the_image_and_are_fused(seen: Path) -> None:
    fixes = [Decoder().decode(r.topic, r.schema, r.data, r.log_time_ns) for r in _records(seen, "/landfix/fix")]
    assert len(fixes) == LOOKS
    for fix in fixes:
        assert isinstance(fix, LandmarkFix)
        assert fix.landmarks == ("ortho.png",)
    last = decode_odometry(_records(seen, "/landfix/odometry")[-1].data)
    assert np.linalg.norm(np.subtract(last.p_n, PLACE)) < 0.7


def test_the_same_again_to_the_bit(folder: Path, seen: Path, tmp_path: Path) -> None:
    text = _replay(folder, seen, tmp_path / "again.mcap")
    assert f"{LOOKS} the same, 0 not" in text
    assert (tmp_path / "again.mcap").read_bytes() == seen.read_bytes()


def test_the_origin_is_the_images_where_none_is_given(folder: Path) -> None:
    text = "".join(line for line in (folder / "flight.toml").read_text().splitlines(True) if "origin" not in line)
    config = folder / "no_origin.toml"
    config.write_text(text)
    origin = load(config).map.origin
    assert origin is not None
    assert origin == pytest.approx((ORIGIN[0] + 160.0 / 111_200.0, ORIGIN[1] - 160.0 / 75_400.0, 488.0), abs=2e-5)


def test_doctor_misses_an_image_that_is_not_there(folder: Path) -> None:
    config = folder / "missing.toml"
    config.write_text('[map]\npicture = "nowhere.tif"\n')
    checks, _ = configuration(config)
    assert any("nowhere.tif" in check.found and check.state == "fail" for check in checks)


def _locate(folder: Path, image: Path, *more: str) -> tuple[int, str, str]:
    prior = f"{ORIGIN[0] + 6.0 / 111_200.0:.7f},{ORIGIN[1]:.7f},600,0.5,-0.5,2"
    arguments = ["locate", str(image), "--rig", str(folder / "rig.yaml"), "--prior", prior, "--prior-sigma", "12,1.5", *more]
    result = CliRunner().invoke(app, arguments)
    return result.exit_code, result.stdout, result.stderr


def test_locate_with_an_image(folder: Path, tmp_path: Path) -> None:
    known = ["--picture", str(folder / "ortho.png"), "--picture-epsg", str(UTM), "--picture-height-m", "488"]
    code, out, err = _locate(folder, folder / "left.png", *known, "--json", "-o", str(tmp_path / "seen.png"))
    assert code == 0, err
    answer = json.loads(out)
    assert answer["fix"]["landmarks"] == ["ortho.png"]
    joint = answer["with_prior"]
    assert (joint["lat_deg"] - ORIGIN[0]) * 111_200.0 == pytest.approx(PLACE[0], abs=3.0)
    assert joint["alt_m"] == pytest.approx(ORIGIN[2] - PLACE[2], abs=1.5)
    assert joint["yaw_deg"] == pytest.approx(0.0, abs=0.2)
    assert (tmp_path / "seen.png").stat().st_size > 10_000
    code, out, err = _locate(folder, folder / "left.png", *known)
    assert code == 0
    assert "blocks agree" in err


def test_locate_reports_what_is_missing(folder: Path, tmp_path: Path) -> None:
    code, _, err = _locate(folder, folder / "left.png")
    assert (code, "--picture" in err) == (2, True)
    code, _, err = _locate(folder, folder / "left.png", "--picture", str(tmp_path / "nowhere.tif"))
    assert (code, "nowhere.tif" in err, "Traceback" in err) == (1, True, False)
    wrong = tmp_path / "wrong.png"
    write(scene.map_image(scene.drawing(2)), wrong)
    code, out, err = _locate(folder, folder / "left.png", "--picture", str(wrong), "--picture-epsg", str(UTM), "--json")
    assert (code, json.loads(out)["fix"]) == (1, None)
    assert "no fix" in err


def test_the_log_names_the_image_and_its_checksum(folder: Path) -> None:
    config = load(folder / "flight.toml")
    metadata = _metadata(config, folder, "digest")
    assert metadata["picture"] == "ortho.png"
    assert metadata["picture_sha256"] == sha256((folder / "ortho.png").read_bytes()).hexdigest()
    assert "picture" not in _metadata(Config(), folder, "digest")
    with pytest.raises(ConfigError, match=r"ortho\.png: no such file"):
        _metadata(config, folder / "elsewhere", "digest")
