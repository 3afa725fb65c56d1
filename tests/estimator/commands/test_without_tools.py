"""What flies runs without the packages of the ground: landfix[tools], [geo], [export], [live], [fleet]."""

import json
import os
import re
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from estimator.tools.doctor.packages import EXTRA_OF
from tests.estimator.service.flying import free_port, listening, toml, until

ROOT = Path(__file__).parents[3]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
BLOCKED = f"""
import sys
sys.modules.update(dict.fromkeys({sorted(EXTRA_OF)}))
from estimator.cli import main
main()
"""
WITHOUT_CAMERAS = BLOCKED.replace("sys.modules.update", 'sys.modules["cv2"] = None; sys.modules.update')
EACH = WITHOUT_CAMERAS.replace(
    "main()\n",
    """
import json
for words in json.loads(sys.argv[1]):
    sys.argv[1:] = words
    try:
        main()
    except SystemExit as done:
        if done.code:
            raise
""",
)


def blocked(*args: object, code: str = BLOCKED) -> list[str]:
    return [sys.executable, "-c", code, *map(str, args)]


def run(*args: object, cwd: Path | None = None, code: str = BLOCKED, **environment: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | environment
    return subprocess.run(blocked(*args, code=code), capture_output=True, text=True, check=False, cwd=cwd, env=environment)


def test_without_cameras_nothing_needs_tools_or_opencv(flight: Path, tmp_path: Path) -> None:
    config, estimate = str(flight.with_suffix(".toml")), str(tmp_path / "e.mcap")
    words = ["doctor", str(flight), "-c", config], ["replay", str(flight), "-o", estimate, "-c", config], ["evaluate", estimate]
    done = run(json.dumps(words), code=EACH)
    assert done.returncode == 0, done.stderr
    done = run("locate", "photo.jpg", "--map", "map.geojson", code=WITHOUT_CAMERAS)
    assert done.returncode == 1
    assert done.stderr == (
        "landfix: this needs OpenCV, which an installation without cameras leaves out: pip install opencv-python-headless\n"
    )


@pytest.mark.long
def test_the_daemon_needs_no_tools_or_opencv(tmp_path: Path) -> None:
    port = free_port()
    config = tmp_path / "vehicle.toml"
    config.write_text(toml(tmp_path, port))
    with subprocess.Popen(blocked("run", "-c", config, code=WITHOUT_CAMERAS), stderr=subprocess.PIPE, text=True) as process:
        try:
            until(lambda: listening(port) or process.poll() is not None, "the daemon listens")
            process.send_signal(signal.SIGINT)
            errors = process.communicate(timeout=60)[1]
        finally:
            process.kill()
    assert process.returncode in {0, 130}, errors
    assert "internal error" not in errors


def test_a_missing_tool_is_one_line_that_names_the_extra(tmp_path: Path) -> None:
    done = run("map", "show", ROOT / "examples/buildings.geojson", "-o", tmp_path / "map.png")
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == "landfix: this needs matplotlib, which is not installed: pip install 'landfix[tools]'"


def test_another_package_with_a_name_of_ours_is_named(tmp_path: Path) -> None:
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "__init__.py").touch()
    done = run("doctor", cwd=tmp_path, PYTHONPATH=f"{tmp_path}:{ROOT}")
    assert done.returncode == 1
    assert done.stderr.startswith(f"landfix: models is taken from {tmp_path / 'models'} and hides {ROOT / 'models'}: rename")
    assert done.stderr.count("\n") == 1


def names(requirements: list[str]) -> set[str]:
    return {re.split(r"[^a-z0-9-]", r.lower().replace("_", "-"))[0] for r in requirements}


def test_the_lock_of_what_flies_has_the_dependencies_and_no_tools() -> None:
    locks = [(ROOT / name).read_text() for name in ("requirements.lock", "requirements-flight.lock")]
    everything, flight = ({m[1]: m[2] for m in re.finditer(r"^([a-z0-9-]+)==([\w.]+)", text, re.M)} for text in locks)
    assert names([r.replace(".", "-", 1) if r.startswith("ruamel") else r for r in PROJECT["dependencies"]]) <= flight.keys()
    assert flight.items() <= everything.items()
    assert not {"matplotlib", "pillow", "pyulog", "pandas", "pyarrow"} & flight.keys()
    assert all("://" not in text and "--hash=sha256:" in text for text in locks)


@pytest.mark.parametrize("extra", ["tools", "export", "geo", "live", "fleet"])
def test_each_extra_is_known_by_the_message(extra: str) -> None:
    modules = {"matplotlib", "pyulog", "pandas", "pyarrow", "pyogrio", "pyproj", "foxglove", "dask", "duckdb", "fsspec"} & {
        m for m, e in EXTRA_OF.items() if e == extra
    }
    assert modules
    for module in modules:
        assert any(r.startswith(module) for r in PROJECT["optional-dependencies"][extra]), module
