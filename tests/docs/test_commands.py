"""Every command of the README and of the tutorials runs as it is written, block after block, as a newcomer would type it.

In these pages ```sh is run here, each page in a folder of its own; ```console is what this machine cannot run: another program's
prompt, a simulator, a daemon that flies until it is stopped. Those are listed below, with where else they are tested.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import typer

from benchmarks.aerial import brighton
from benchmarks.flights.tasks import data_folder
from calib.board.chessboard import Board
from calib.cameras.bundle import Pose
from calib.files.formats import load_rig
from estimator.cli import app
from estimator.config import load
from logs.store.recorder import Recorder
from logs.wire.codec import encode_input
from logs.wire.images import encode_image
from models import so3
from models.camera import CameraModel, StereoRig
from models.frames import GRAVITY
from models.messages import GnssFix, GnssVelocity, ImuSample, vec3
from models.sim.scenario import simulate
from models.sim.scenario_file import loads
from tests.boards import views
from tests.boards.motion import EUROC_NOISE, Truth, record
from tests.docs import started
from tests.estimator.commands.photos import of_scene
from tests.real import footprints
from tests.real.tagged_photos import tagged
from vision.synthetic.scenes import WorldSpec, make_world

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("tutorial_*.md"))]
ALL_PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.md"))]
IMAGE_MIDDLE = 33.638396, -84.478936  # of the satellite image
DJI_0033 = 46.842547, -91.993694  # by SIFT in the orthophoto
BOARD = Board(9, 6, 0.025)
LEFT = CameraModel(320, 240, 270.0, 271.0, 158.0, 121.0, (-0.2, 0.05, 0.0, 0.0))
SETTINGS = {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "COLUMNS": "150"}
RIG = StereoRig(LEFT, LEFT, np.eye(3), np.array([-0.06, 0.0, 0.0]), np.eye(3), np.zeros(3))

# What ```console may hold, by how it begins. Our own of these: tests/estimator/service/, tests/docs/test_sitl_fixes.py.
NOT_RUN = {
    "make px4_sitl ": "PX4", "param set ": "PX4 and ArduPilot", "commander ": "PX4", "failure ": "PX4", "listener ": "PX4",
    "sim_vehicle.py ": "ArduPilot", "mode ": "ArduPilot", "arm ": "ArduPilot", "takeoff ": "ArduPilot", "rc ": "ArduPilot",
    "reboot": "ArduPilot", "param fetch": "ArduPilot",
    "landfix run ": "flies until it is stopped", "landfix monitor ": "watches until it is stopped",
    "landfix start ": "tests/estimator/service/test_daemon.py",
    "landfix doctor -c examples/ardupilot_sitl.toml --autopilot ": "needs a simulator",
    **dict.fromkeys(
        (f"landfix {name} out/sitl/" for name in ("report", "doctor", "replay", "evaluate")), "of a flight in a simulator"
    ),
    "landfix import dataflash ": "tests/flown", "python examples/sitl_fixes.py ": "needs a simulator",
    "make install": "has put this in place", "source ": "the shell's own",
    "git clone ": "the network",
    "make demo": "tests/estimator/tools/test_demo.py flies a shorter one", "make test": "is what runs this",
}  # fmt: skip


def blocks(page: Path, language: str) -> list[str]:
    """The fenced blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


def lines(text: str) -> Iterator[str]:
    """Commands without their comments."""
    for line in text.replace("\\\n", " ").splitlines():
        command = re.sub(r"\s+#\s.*$", "", line).strip()
        if command and not command.startswith("#"):
            yield command


# ------------------------------------------------------------------------------------------------ what the reader brings along


def a_csv_flight(folder: Path) -> None:
    """FLIGHT_DIR with IMU and receiver of a simulated flight; flight.toml is written by the import."""
    source = folder / "FLIGHT_DIR"
    source.mkdir()
    scenario = 'duration_s = 40.0\n[vehicle]\nkind = "multirotor"\n[imu]\nrate_hz = 100.0\n[gnss]\n'
    messages = list(simulate(loads(scenario), seed=1).messages)
    start_ns = messages[0].t_ns
    imu = [(1e-9 * (m.t_ns - start_ns), *m.gyro_b, *m.accel_b) for m in messages if isinstance(m, ImuSample)]
    velocity = {m.t_ns: m.v_n for m in messages if isinstance(m, GnssVelocity)}
    gps = [
        (1e-9 * (m.t_ns - start_ns), m.lat_deg, m.lon_deg, m.alt_m, *velocity[m.t_ns])
        for m in messages
        if isinstance(m, GnssFix) and m.t_ns in velocity
    ]
    np.savetxt(source / "imu.csv", imu, delimiter=",", fmt="%.9f", comments="", header="t_s,gx,gy,gz,fx,fy,fz")
    header = "t_s,lat_deg,lon_deg,alt_m,vn_m_s,ve_m_s,vd_m_s"
    np.savetxt(source / "gps.csv", gps, delimiter=",", fmt="%.9f", comments="", header=header)


def a_board_and_an_imu(folder: Path) -> None:
    """Twelve rendered pairs of a board, an IMU at rest, and ten seconds of a camera that is moved before the board."""
    rng, painter = np.random.default_rng(3), views.Painter(LEFT, BOARD)
    (folder / "board").mkdir()
    for k, pose in enumerate(views.poses(views.both(RIG), BOARD, 12, rng)):
        for name, (_, place) in zip(("left", "right"), views.both(RIG), strict=True):
            seen = Pose(place.R @ pose.R, place.of(pose.t[None])[0])
            cv2.imwrite(str(folder / "board" / f"{name}{k:02d}.png"), painter.paint(seen, rng))
    with Recorder(folder / "still.mcap") as log:
        for t_ns in range(10**18, 10**18 + 60 * 10**9, 10**7):
            gyro, accel = rng.normal(0.0, 1.7e-3, 3), np.array([0.0, 0.0, -GRAVITY]) + rng.normal(0.0, 0.02, 3)
            log.write(*encode_input(ImuSample(t_ns, t_ns, vec3(gyro), vec3(accel))), t_ns)
    R_bc = so3.matrix(so3.quat_exp(np.array([0.1, -0.2, 0.05]))) @ np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    true = Truth(R_bc, np.array([0.05, -0.02, 0.03]), 0.012, 10.0, camera_hz=10.0, distance_m=0.6)
    imu, stamps, _, motion = record(true, LEFT, BOARD, EUROC_NOISE, rng)
    with Recorder(folder / "moving.mcap") as log:
        for t_ns, gyro, accel in zip(imu.t_ns.tolist(), imu.gyro, imu.accel, strict=True):
            log.write(*encode_input(ImuSample(t_ns, t_ns, vec3(gyro), vec3(accel))), t_ns)
        for t_ns in stamps.tolist():
            R_oc, p_o = motion.camera(1e-9 * (t_ns - int(imu.t_ns[0])) + true.time_offset_s)
            image = painter.paint(Pose(R_oc.T, -R_oc.T @ p_o), rng)
            log.write(*encode_image(t_ns, image, "/left/image", jpeg_quality=95), t_ns)


def a_photo_and_footprints(folder: Path) -> None:
    """A rendered photo with a drone's tags, 3 m off; outlines, heights and colours of the buildings, nothing else."""
    spec = WorldSpec("lookalikes", painted=1.0, area_m=240.0, sigma_m=0.2, height_sigma_m=0.1, outline_sigma_m=0.05)
    scene = make_world(2, spec)
    off, place = np.array([2.5, -1.5, 2.0]), np.array([0.0, 0.0, -80.0])
    p_nc = of_scene(folder / "DJI_0001.JPG", scene, place, (0.04, -0.03, 0.7), off=off)
    file = json.loads(scene.map.to_geojson())
    for feature in file["features"]:
        theirs = feature["properties"]
        feature["properties"] = {"height": str(theirs["height_m"]), "roof:colour": theirs.get("colour", "")}
    (folder / "footprints.geojson").write_text(json.dumps({"type": file["type"], "features": file["features"]}))
    (folder / "truth.json").write_text(json.dumps(scene.map.frame.to_geodetic(p_nc)))


def a_satellite_image_and_a_photo(folder: Path) -> None:
    """The public files of the page, the photo with its tags written into it again."""
    data = data_folder()
    if not (data / footprints.FOLDER).is_dir() or not (data / brighton.FOLDER).is_dir():
        pytest.skip("the public images are not here (LANDFIX_DATA)")
    for name in ("geotiff_labels.geojson", "sample_geotiff.tif"):
        (folder / name).symlink_to(data / footprints.FOLDER / name)
    tagged(data, "DJI_0033.jpg", folder).rename(folder / "DJI_0033.JPG")
    (folder / "benchmarks").symlink_to(ROOT / "benchmarks")


def a_log_of_px4(folder: Path) -> None:
    """Six seconds of a ULog as the autopilot wrote it."""
    log = data_folder() / "native_logs" / "px4_fmuv6c_6s.ulg"
    if not log.is_file():
        pytest.skip("the public logs are not here (LANDFIX_DATA)")
    (folder / "FLIGHT.ulg").symlink_to(log)


def a_lighter_scenario(folder: Path) -> None:
    """The page's scenario with half of the IMU's samples; tests/scenarios flies it as it is."""
    scenarios = folder / "examples/scenarios"
    scenarios.mkdir(parents=True)
    text = (ROOT / "examples/scenarios/rare_fixes.toml").read_text()
    assert text.count("rate_hz = 200.0") == 1
    (scenarios / "rare_fixes.toml").write_text(text.replace("rate_hz = 200.0", "rate_hz = 100.0"))


BROUGHT: dict[str, Callable[[Path], None]] = {
    "README": a_csv_flight,
    "tutorial_calibrate": a_board_and_an_imu,
    "tutorial_photo": a_photo_and_footprints,
    "tutorial_first_hour": a_satellite_image_and_a_photo,
    "tutorial_own_log": a_log_of_px4,
    "tutorial_replay": a_lighter_scenario,
}


# -------------------------------------------------------------------------------------------------------------- what it must give


def replayed(folder: Path, said: str) -> None:
    assert "careless" in said
    assert (folder / "out/tutorial/report.html").stat().st_size > 100_000


def calibrated(folder: Path, said: str) -> None:
    assert said.count("Verdict: ") == 3
    rig = load_rig(folder / "vehicle_rig.yaml")
    assert abs(rig.time_offset_s - 0.012) < 5e-4
    assert np.allclose(rig.p_bc, (0.05, -0.02, 0.03), atol=5e-3)


def mapped(folder: Path, said: str) -> None:
    assert "ambiguous landmarks" in said
    assert (folder / "out/tutorial/map.png").stat().st_size > 20_000


def apart_m(place: tuple[float, float], other: tuple[float, ...]) -> float:
    """Between a latitude and longitude and others near by."""
    scale = 111_200.0 * np.array([1.0, np.cos(np.radians(other[0]))])
    return float(np.linalg.norm(scale * np.subtract(place, other[:2])))


def located(folder: Path, said: str) -> None:
    true = json.loads((folder / "truth.json").read_text())
    lat, lon = (float(re.findall(rf"{name} +(-?[\d.]+) deg", said)[-1]) for name in ("latitude", "longitude"))
    assert apart_m((lat, lon), true) < 1.5
    assert (folder / "seen.png").stat().st_size > 100_000


def twice_located(folder: Path, said: str) -> None:
    """The satellite image where its own coordinates have it, the photo where SIFT and the orthophoto do."""
    lat, lon = ([float(x) for x in re.findall(rf"{name} +(-?[\d.]+) deg", said)] for name in ("latitude", "longitude"))
    places = list(zip(lat, lon, strict=True))  # of each: by the image alone, with the prior
    for (north, east), true, off_m in ((places[1], IMAGE_MIDDLE, 2.0), (places[3], DJI_0033, 2.0)):
        assert apart_m((north, east), true) < off_m
    assert "OpenStreetMap contributors" in (folder / "atlanta.geojson").read_text()
    assert (folder / "satellite.png").stat().st_size > 100_000
    assert (folder / "photo.png").stat().st_size > 100_000


def tuned(folder: Path, said: str) -> None:
    noise, default = load(folder / "out/tune/tuned.toml").imu, load(None).imu
    assert noise.accel_noise < default.accel_noise
    gain = re.search(r"held out: \+([\d.]+)", said)
    assert gain, "the flight that was held out is not predicted better"
    assert float(gain[1]) > 0.1


def reported(folder: Path, _: str) -> None:
    assert (folder / "report.html").stat().st_size > 100_000


GIVES: dict[str, Callable[[Path, str], None]] = {
    "README": reported,
    "tutorial_own_log": reported,
    "tutorial_replay": replayed,
    "tutorial_calibrate": calibrated,
    "tutorial_map": mapped,
    "tutorial_photo": located,
    "tutorial_first_hour": twice_located,
    "tutorial_tune": tuned,
}


@pytest.fixture(scope="module")
def landfix(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with the program, whose packages are imported once."""
    programs = tmp_path_factory.mktemp("bin")
    server, program = programs / "s", programs / "landfix"
    program.write_text(started.PROGRAM.format(python=sys.executable, socket=str(server)))
    program.chmod(0o755)
    words = [sys.executable, "-c", "from tests.docs import started; started.main()", str(server)]
    with subprocess.Popen(words, cwd=ROOT, env=os.environ | SETTINGS, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout
            assert process.stdout.readline() == b"ready\n"
            yield programs
        finally:
            process.terminate()


def typed(page: Path, tmp_path: Path, programs: Path) -> str:
    """What the commands of a page print, one after the other."""
    if not (tmp_path / "examples").exists():
        (tmp_path / "examples").symlink_to(ROOT / "examples")
    script = "\n".join(["set -eu", *blocks(page, "sh")])
    environment = os.environ | SETTINGS | {"PATH": f"{programs}:{os.environ['PATH']}"}
    bash = shutil.which("bash")
    assert bash
    done = subprocess.run([bash, "-c", script], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    return done.stdout


LONG = {"tutorial_calibrate", "tutorial_first_hour", "tutorial_own_log", "tutorial_replay", "tutorial_tune"}


@pytest.mark.parametrize(
    "page",
    [pytest.param(p, marks=[pytest.mark.long] if p.stem in LONG else []) for p in PAGES if blocks(p, "sh")],
    ids=lambda p: p.stem,
)
def test_every_command_works_as_it_is_written(page: Path, tmp_path: Path, landfix: Path) -> None:
    if page.stem in BROUGHT:
        BROUGHT[page.stem](tmp_path)
    said = typed(page, tmp_path, landfix)
    if page.stem in GIVES:
        GIVES[page.stem](tmp_path, said)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_what_is_not_run_here_is_known(page: Path) -> None:
    commands = [command for block in blocks(page, "console") for command in lines(block)]
    assert [c for c in commands if not any(f"{c} ".startswith(known) for known in NOT_RUN)] == []


def test_the_list_of_what_is_not_run_holds_nothing_else() -> None:
    commands = [f"{command} " for page in PAGES for block in blocks(page, "console") for command in lines(block)]
    assert [known for known in NOT_RUN if not any(c.startswith(known) for c in commands)] == []


def unknown(command: str) -> list[str]:
    """What of `landfix X --option` the program itself does not parse."""
    group: Any = typer.main.get_command(app)
    words = command.split()[1:]
    while hasattr(group, "commands") and words and not words[0].startswith("-"):
        if words[0] not in group.commands:
            return [words[0]]
        group = group.commands[words.pop(0)]
    known = {option for parameter in group.params for option in (*parameter.opts, *parameter.secondary_opts)} | {"-h", "--help"}
    return sorted({w for w in words if re.fullmatch(r"--?[a-z][a-z-]*", w)} - known)


@pytest.mark.parametrize("page", ALL_PAGES, ids=lambda p: p.stem)
def test_commands_and_options_of_all_pages_exist(page: Path) -> None:
    """Those of reference pages, too, which are not run."""
    for command in lines("\n".join(blocks(page, "(?:sh|console)?"))):
        if command.startswith("landfix "):
            assert unknown(command) == [], f"{page.name}: {command}"


def helps(group: Any, name: str) -> Iterator[tuple[str, str]]:
    """Every command with its help."""
    yield name, group.help or ""
    for word, command in getattr(group, "commands", {}).items():
        yield from helps(command, f"{name} {word}")


def test_commands_and_options_of_the_helps_examples_exist() -> None:
    """`landfix X --help` shows options that X has."""
    examples = [(n, line.strip()) for n, text in helps(typer.main.get_command(app), "landfix") for line in text.splitlines()]
    ours = [(name, re.split(r"\s{2,}", line)[0]) for name, line in examples if line.startswith("landfix ")]
    assert len(ours) > 60
    assert [(name, line, unknown(line)) for name, line in ours if unknown(line)] == []
