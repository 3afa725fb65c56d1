"""The map in recorded images: the video plays, the residual is the error of the estimate, nothing is drawn without reason."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from calib.files.formats import save_rig
from estimator.cli import app
from estimator.tools.overlay.log import read, views
from logs.store.reader import LogReader
from logs.store.recorder import Recorder
from logs.wire.codec import encode, encode_input
from models.messages import Estimate, Health, ImageName, LandmarkFix, Mode, VisionRequest, vec3
from models.sim.scenario import EPOCH_NS
from models.state import E, X
from tests import long
from tests.estimator.scenes import SECOND
from tests.estimator.sights import PLACE, SEEN_S, village
from vision.show.overlay import in_view

SIGMA_M = 0.2


def _estimate(t_ns: int, east_m: float, sigma_m: float = SIGMA_M) -> Estimate:
    """At PLACE, that far off to the east; 1 sigma of position sigma_m, of attitude hardly anything."""
    nav, covariance = np.zeros(X.SIZE), np.eye(E.SIZE) * 1e-10
    nav[X.P], nav[X.Q] = np.add(PLACE, (0.0, east_m, 0.0)), (1.0, 0.0, 0.0, 0.0)
    covariance[E.P, E.P] = np.eye(3) * sigma_m**2
    return Estimate(t_ns, t_ns, nav, covariance, (0.0, 0.0, 0.0), Mode.AIDED, 0, t_ns)


def _health(t_ns: int, mode: Mode) -> Health:
    return Health(t_ns, t_ns, mode, 0.0, 0.5, 0.1, 0, {}, {}, 1)


def _write(
    path: Path, east_m: float = 0.0, sigma_m: float = SIGMA_M, *, identified: tuple[str, ...] = (), attached: bool = True
) -> Path:
    """Estimates of 50 Hz around the four images, the last two of which are dead reckoned; a fix of the first image."""
    seen = village()
    messages = [(pair[0], EPOCH_NS + round(s * SECOND)) for s, pair in zip(SEEN_S, seen.pairs, strict=True)]
    for k in range(-5, 105):
        t_ns = EPOCH_NS + round((SEEN_S[0] + 0.02 * k) * SECOND)
        messages += [(message, t_ns) for message in encode(_estimate(t_ns, east_m, sigma_m))]
    for at_s, mode in ((5.5, Mode.AIDED), (6.9, Mode.DEAD_RECKONING)):
        t_ns = EPOCH_NS + round(at_s * SECOND)
        messages += [(message, t_ns) for message in encode(_health(t_ns, mode))]
    if identified:
        t_ns = EPOCH_NS + round(SEEN_S[0] * SECOND)
        fix = LandmarkFix(t_ns, t_ns, PLACE, (1.0, 0.0, 0.0, 0.0), np.eye(6) * 1e-2, None, identified, 0.9, 0.3)
        messages.append((encode_input(fix), t_ns))
    with Recorder(path) as recorder:
        for message, t_ns in sorted(messages, key=lambda item: item[1]):
            recorder.write(*message, t_ns)
        if attached:
            save_rig(path.with_name("rig.yaml"), seen.rig)
            recorder.attach("calibration/rig.yaml", "application/yaml", path.with_name("rig.yaml").read_bytes())
            recorder.attach("map/village.geojson", "application/geo+json", seen.map.to_geojson())
            path.with_name("rig.yaml").unlink()
    return path


def _run(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["overlay", *map(str, arguments)])


def _numbers(*arguments: object) -> dict[str, object]:
    result = _run(*arguments, "--json")
    assert result.exit_code == 0, result.output
    return dict(json.loads(result.stdout))


def _in_sight() -> list[str]:
    seen = village()
    p_nc, R_nc = seen.rig.camera_pose(np.array(PLACE), np.eye(3))
    return [mark.id for mark in in_view(seen.rig.left, p_nc, R_nc, seen.map.near(0.0, 0.0, 150.0))]


@long.parametrize("east_m", [0.5, 0.0])
def test_the_residual_is_the_error_of_the_estimate(tmp_path: Path, east_m: float) -> None:
    """0.5 m at 75 m are f / 75 / 2 px along the normals of half the edges, and nothing along the others."""
    said = _numbers(_write(tmp_path / "a.mcap", east_m))
    residual, ratio = said["residual_px"], said["ratio"]
    assert isinstance(residual, dict)
    assert isinstance(ratio, float)
    assert residual["n"] == 4
    shift_px = village().rig.left.fx * east_m / 75.0
    expected_px = village().rig.left.fx * SIGMA_M / 75.0
    if east_m == 0.0:
        assert 0.02 < residual["median"] < 1.0
        assert ratio < 0.6
    else:
        assert 0.5 * shift_px < residual["median"] < 1.5 * shift_px
        assert 0.7 < ratio * expected_px / residual["median"] < 1.2


@long.parametrize("sigma_m", [1.0, 0.2])
def test_edges_are_looked_for_as_far_as_the_estimate_may_be_off(tmp_path: Path, sigma_m: float) -> None:
    """1.5 m are 14 px: beyond 3 sigma of an overconfident filter, found where it is consistent."""
    residual = _numbers(_write(tmp_path / "a.mcap", 1.5, sigma_m))["residual_px"]
    shift_px = village().rig.left.fx * 1.5 / 75.0
    found = residual["median"] if isinstance(residual, dict) else 0.0
    assert (0.5 * shift_px < found < 1.6 * shift_px) == (sigma_m == 1.0)


def test_the_video_plays_with_map_and_strip_in_it(tmp_path: Path) -> None:
    marks = _in_sight()
    log, video = _write(tmp_path / "a.mcap", identified=(marks[0],)), tmp_path / "a.mp4"
    said = _run(log, "-o", video, "--all")
    assert said.exit_code == 0, said.output
    assert "4 images" in said.stdout
    assert f"{video}  {video.with_suffix('.png')}" in said.stdout
    assert video.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    film = cv2.VideoCapture(str(video))
    assert film.get(cv2.CAP_PROP_FPS) == pytest.approx(2.0)
    frames = []
    while (step := film.read())[0]:
        frames.append(step[1].astype(int))
    assert len(frames) == 4
    camera = village().rig.left
    height = frames[0].shape[0]
    assert camera.height < height < 1.15 * camera.height
    assert frames[0].shape[1] == camera.width
    strip = frames[0][camera.height + 2 :]
    assert strip.max() > 180, "light text"
    assert np.median(strip) < 60, "on dark ground"
    assert np.abs(strip - frames[3][camera.height + 2 :]).max() > 100, "another time, another mode"
    green = [np.count_nonzero((f[..., 1] > 180) & (f[..., 1] > f[..., 0] + 60) & (f[..., 1] > f[..., 2] + 60)) for f in frames]
    assert green[0] > green[1] + 200, "only the first image has a fix"


@pytest.mark.long
def test_only_what_fixes_used_is_measured_unless_all_is_asked_for(tmp_path: Path) -> None:
    marks = _in_sight()
    log = _write(tmp_path / "a.mcap", identified=(marks[0],))
    few, everything = _numbers(log), _numbers(log, "--all")
    assert isinstance(few["landmarks"], list)
    assert isinstance(everything["landmarks"], list)
    assert [row["id"] for row in few["landmarks"]] == [marks[0]]
    assert len(everything["landmarks"]) > 3
    assert few["with_fix_px"] is not None
    moments = few["moments"]
    assert isinstance(moments, list)
    assert [m["mode"] for m in moments] == ["aided", "aided", "dead_reckoning", "dead_reckoning"]
    assert [m["identified"] for m in moments] == [1, 0, 0, 0]
    assert all(m["radius95_m"] == pytest.approx(2.4477 * SIGMA_M, rel=1e-3) for m in moments)


@pytest.mark.long
def test_images_are_chosen_and_no_video_is_written_unasked(tmp_path: Path) -> None:
    log = _write(tmp_path / "a.mcap")
    moments = [_numbers(log, *choice)["moments"] for choice in (["--every", 3], ["--start", 0.9], ["--seconds", 0.6])]
    assert [[m["t_s"] for m in rows] for rows in moments if isinstance(rows, list)] == [[0.0, 1.5], [1.0, 1.5], [0.0, 0.5]]
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


def test_cameras_and_map_come_from_options_before_the_log(tmp_path: Path) -> None:
    log = _write(tmp_path / "a.mcap")
    (tmp_path / "other.geojson").write_bytes(b'{"type": "FeatureCollection", "features": []}')
    assert _numbers(log, "--map", tmp_path / "other.geojson")["landmarks"] == []
    config = tmp_path / "other.toml"
    config.write_text('[map]\norigin = [47.0, 8.0, 500.0]\nlandmarks = "other.geojson"\n')
    assert _numbers(log, "-c", config)["landmarks"] == []


def test_without_attachments_the_files_beside_the_log_serve_that_its_configuration_names(tmp_path: Path) -> None:
    log = _write(tmp_path / "a.mcap", attached=False)
    bare = _run(log)
    assert (bare.exit_code, bare.stderr) == (
        1,
        f"landfix: {log}: neither holds nor names a calibration of its cameras; give one with --rig FILE\n",
    )
    save_rig(tmp_path / "rig.yaml", village().rig)
    (tmp_path / "map.geojson").write_bytes(village().map.to_geojson())
    (tmp_path / "c.toml").write_text('[map]\nlandmarks = "map.geojson"\n[rig]\nfile = "rig.yaml"\n')
    assert _numbers(log, "-c", tmp_path / "c.toml")["images"] == 4
    no_map = _run(log, "--rig", tmp_path / "rig.yaml")
    assert "neither holds nor names a map of landmarks; give one with --map FILE" in no_map.stderr


def test_a_log_with_nothing_to_draw_reports_it_in_one_line(tmp_path: Path) -> None:
    empty, blind = tmp_path / "empty.mcap", tmp_path / "blind.mcap"
    with Recorder(empty) as recorder:
        recorder.write(*village().pairs[0][0], EPOCH_NS)
    with Recorder(blind) as recorder:
        recorder.write(*encode(_estimate(EPOCH_NS, 0.0))[0], EPOCH_NS)
        recorder.write(*village().pairs[0][1], EPOCH_NS)
    expected = {
        empty: f"landfix: {empty}: holds no /landfix/odometry; make an estimate first: landfix replay {empty} -o estimate.mcap\n",
        blind: f"landfix: {blind}: holds no images on /left/image; it holds images on /right/image\n",
        tmp_path / "none.mcap": f"landfix: {tmp_path / 'none.mcap'}: no such file or directory\n",
    }
    for log, line in expected.items():
        result = _run(log, "-o", tmp_path / "v.mp4")
        assert (result.exit_code, result.stderr) == (1, line)
    torn = tmp_path / "torn.mcap"
    with LogReader(_write(tmp_path / "a.mcap")) as reader, Recorder(torn) as recorder:
        for r in reader:
            recorder.write(r.topic, r.schema, r.data[:200] if r.topic == "/left/image" else r.data, r.log_time_ns)
        for attachment in reader.attachments:
            recorder.attach(*attachment)
    assert _run(torn).stderr == f"landfix: {torn}: none of the 4 images can be read\n"
    log = tmp_path / "a.mcap"
    assert "no kind of video" in _run(log, "-o", tmp_path / "v.gif").stderr
    assert "is no folder" in _run(log, "-o", tmp_path / "nowhere" / "v.mp4").stderr
    assert "no kind of picture" in _run(log, "--plot", log).stderr
    assert "none is chosen" in _run(log, "--start", 100).stderr


def test_images_of_another_camera_are_refused(tmp_path: Path) -> None:
    log = _write(tmp_path / "a.mcap")
    rig = village().rig
    text = tmp_path / "rig.yaml"
    save_rig(text, rig)
    text.write_text(text.read_text().replace(f"{rig.left.width}", f"{rig.left.width * 2}"))
    assert "not the same camera" in _run(log, "--rig", text).stderr


def test_the_exposure_is_what_vision_was_reported(tmp_path: Path) -> None:
    """An image vision was not asked about is as late as the one before it; the first one as the rig says."""
    path = tmp_path / "a.mcap"
    stamps = [round(s * SECOND) for s in SEEN_S]
    late_ns = 40_000_000
    with Recorder(path) as recorder:
        for k in range(500):
            t_ns = EPOCH_NS + k * 20_000_000
            recorder.write(*encode(_estimate(t_ns, east_m=k * 0.02))[0], t_ns)
        for k, pair in enumerate(village().pairs):
            t_ns = EPOCH_NS + stamps[k]
            recorder.write(*pair[0], t_ns)
            if k == 1:
                name = ImageName("/left/image", t_ns)
                request = VisionRequest(t_ns + late_ns, t_ns, vec3(PLACE), (1.0, 0.0, 0.0, 0.0), np.eye(6), name, None)
                recorder.write(*encode(request)[0], t_ns)
    flight = read(path)
    found = views(flight, "/left/image", 0.01)
    offsets = [view.t_ns - EPOCH_NS - stamp for view, stamp in zip(found, stamps, strict=True) if view]
    assert offsets == [10_000_000, late_ns, late_ns, late_ns]
    for view in found:
        assert view is not None
        assert view.p_n[1] == pytest.approx((view.t_ns - EPOCH_NS) * 1e-9, abs=1e-6), "1 m/s east"
        np.testing.assert_allclose(view.R_nb, np.eye(3), atol=1e-9)
    before = views(flight, "/left/image", -10.0)
    assert before[0] is None
    assert before[1] is not None
