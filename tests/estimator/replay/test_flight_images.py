"""Images of a simulated flight: in the log, in order, and of what the truth says is there."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from calib.files.formats import load_rig
from estimator.cli import app
from estimator.config import load
from estimator.map_files import store as map_store
from estimator.replay import flight_images
from logs.store.reader import LogReader
from logs.wire.images import decode_image
from logs.wire.schemas import COMPRESSED_IMAGE, IMAGE
from logs.wire.stamps import stamp_of
from models.sim.scenario import EPOCH_NS, simulate
from models.sim.scenario_file import ScenarioError, loads

SCENARIO = """
duration_s = 24.0
[vehicle]
kind = "multirotor"
seed = 3
[imu]
rate_hz = 100.0
[cameras]
rate_hz = 1.0
width = 320
height = 240
focal_px = 300.0
jpeg_quality = {quality}
outages_s = [[5.0, 8.0]]
dark_s = [[15.0, 17.0]]
[cameras.world]
painted = 1.0
unmapped = 0.3
sigma_m = 0.4
area_m = 160.0
spacing_m = 16.0
"""


def fly(folder: Path, quality: int = 92, duration_s: float = 24.0) -> Path:
    text = SCENARIO.format(quality=quality).replace("duration_s = 24.0", f"duration_s = {duration_s}")
    (folder / "scenario.toml").write_text(text)
    out = folder / "flight.mcap"
    result = CliRunner().invoke(app, ["simulate", str(folder / "scenario.toml"), "-o", str(out), "--seed", "4"])
    assert result.exit_code == 0, result.output
    return out


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fly(tmp_path_factory.mktemp("flight"))


def images(log: Path) -> dict[str, list[tuple[int, int, np.ndarray]]]:
    """(exposure, arrival, image) by topic."""
    found: dict[str, list[tuple[int, int, np.ndarray]]] = {flight_images.LEFT: [], flight_images.RIGHT: []}
    with LogReader(log) as reader:
        for record in reader:
            if record.topic in found:
                stamp = stamp_of(record.data)
                assert stamp is not None
                found[record.topic].append((stamp, record.log_time_ns, decode_image(record.schema, record.data)))
    return found


def test_pairs_at_their_rate_but_in_outages(log: Path) -> None:
    left, right = images(log).values()
    assert [p[0] for p in left] == [p[0] for p in right]
    since_s = np.array([p[0] - EPOCH_NS for p in left]) * 1e-9
    np.testing.assert_allclose(since_s, [k + 1 / 3 for k in range(24) if not 5 <= k < 8], atol=1e-6)
    assert {p[1] - p[0] for p in left + right} == {60_000_000}
    assert left[0][2].shape == (240, 320, 3)


def test_a_covered_lens_is_dark_and_light_swings(log: Path) -> None:
    left, _ = images(log).values()
    dark = [float(p[2].mean()) for p in left if 15 <= (p[0] - EPOCH_NS) * 1e-9 < 17]
    light = [float(p[2].mean()) for p in left if not 15 <= (p[0] - EPOCH_NS) * 1e-9 < 17]
    assert max(dark) < 3.0
    assert min(light) > 40.0


def test_roofs_are_where_truth_and_rig_put_them(log: Path) -> None:
    """The median colour inside each painted roof's projected outline is that roof's, in both cameras."""
    simulation = simulate(loads(SCENARIO.format(quality=92)), 4)
    cameras = loads(SCENARIO.format(quality=92)).cameras
    assert cameras
    scene = flight_images.plan(cameras, simulation, 4).scene
    checked, near = 0, 0
    for side, shots in enumerate(images(log).values()):
        for t_ns, _, image in shots[12:]:
            k = int(np.searchsorted(simulation.truth.t_ns, t_ns, side="right")) - 1
            p_n = simulation.truth.p_n[k] + simulation.truth.v_n[k] * (t_ns - simulation.truth.t_ns[k]) * 1e-9
            R_nb = simulation.truth.R_nb[k]
            p, R = scene.rig.right_camera_pose(p_n, R_nb) if side else scene.rig.camera_pose(p_n, R_nb)
            camera = scene.rig.right if side else scene.rig.left
            if image.mean() < 5.0:
                continue
            for mark, appearance in zip(scene.world.landmarks, scene.world.appearances, strict=True):
                shrunk = mark.outline_n + 0.2 * (np.array(mark.centre_n) - mark.outline_n)
                px = camera.project((np.column_stack([shrunk, np.full(len(shrunk), mark.roof_d)]) - p) @ R)
                if camera.contains(px, 2.0).all():
                    u, v = np.rint(px).astype(int).T
                    seen = np.median(image[v, u].astype(float), axis=0)
                    chroma = [c / c.sum() for c in (seen, np.array(appearance.roof_bgr))]
                    checked += 1
                    near += bool(np.abs(chroma[0] - chroma[1]).max() < 0.1)
    assert checked > 10
    assert near / checked > 0.9


def test_what_the_vehicle_is_reported(log: Path) -> None:
    """Map and rig have their errors, and the configuration finds them."""
    config = load(log.with_suffix(".toml"))
    assert config.rig.file == "flight_rig.yaml"
    assert config.map.landmarks == "flight_map.geojson"
    assert (config.inputs.left_image, config.inputs.right_image) == ((flight_images.LEFT,), (flight_images.RIGHT,))
    cameras = loads(SCENARIO.format(quality=92)).cameras
    assert cameras
    scene = flight_images.plan(cameras, simulate(loads(SCENARIO.format(quality=92)), 4), 4).scene
    rig, landmarks = load_rig(log.with_name("flight_rig.yaml")), map_store.load(log.with_name("flight_map.geojson"))
    np.testing.assert_allclose(rig.R_bc, scene.rig_calibrated.R_bc, atol=1e-9)
    assert not np.allclose(rig.R_bc, scene.rig.R_bc, atol=1e-6)
    assert len(landmarks) == len(scene.map)
    off = [np.subtract(landmarks[m.id].centre_n, m.centre_n) for m in scene.world.landmarks]
    assert 0.3 < np.std(off) < 0.5  # sigma_m = 0.4


@pytest.mark.long
def test_equal_seeds_give_equal_logs_and_raw_pixels_on_request(log: Path, tmp_path: Path) -> None:
    assert fly(tmp_path).read_bytes() == log.read_bytes()
    with LogReader(log) as reader:
        assert {r.schema for r in reader if r.topic == flight_images.LEFT} == {COMPRESSED_IMAGE}
    with LogReader(fly(tmp_path, 0, duration_s=3.0)) as reader:
        assert {r.schema for r in reader if r.topic == flight_images.LEFT} == {IMAGE}


def test_no_images_on_request(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(SCENARIO.format(quality=92))
    result = CliRunner().invoke(app, ["simulate", str(tmp_path / "s.toml"), "-o", str(tmp_path / "f.mcap"), "--no-images"])
    assert result.exit_code == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["f.mcap", "f.toml", "s.toml"]
    assert load(tmp_path / "f.toml").rig.file is None


def test_cameras_need_a_place_on_earth() -> None:
    with pytest.raises(ScenarioError, match="cameras"):
        loads("geographic = false\n[cameras]\n")
