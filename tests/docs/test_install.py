""".ci/install: by uv, by pip where uv cannot, with hashes, and nothing printed that alarms while it goes well. No network."""

import hashlib
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
UV = ROOT / ".venv/bin/uv"
WHEEL = "tiny_wheel-1.0-py3-none-any.whl"
DIST_INFO = "tiny_wheel-1.0.dist-info"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a virtual environment, a wheel, and a lock file that names it."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", tmp_path / ".venv"], check=True)
    with zipfile.ZipFile(tmp_path / WHEEL, "w") as wheel:
        wheel.writestr("tiny_wheel.py", "")
        wheel.writestr(f"{DIST_INFO}/METADATA", "Metadata-Version: 2.1\nName: tiny-wheel\nVersion: 1.0\n")
        wheel.writestr(f"{DIST_INFO}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        wheel.writestr(
            f"{DIST_INFO}/RECORD", f"tiny_wheel.py,,\n{DIST_INFO}/METADATA,,\n{DIST_INFO}/WHEEL,,\n{DIST_INFO}/RECORD,,\n"
        )
    digest = hashlib.sha256((tmp_path / WHEEL).read_bytes()).hexdigest()
    (tmp_path / "tiny.lock").write_text(f"tiny-wheel==1.0 \\\n    --hash=sha256:{digest}\n")
    return tmp_path


def uv_is(folder: Path, script: str = "") -> None:
    """The uv of the environment: the real one, or a script in its place."""
    if not script and not UV.exists():
        pytest.skip(f"{UV} is not there: make install")
    place = folder / ".venv/bin/uv"
    if script:
        place.write_text(f"#!/bin/sh\n{script}\n")
        place.chmod(0o755)
    else:
        place.symlink_to(UV)


def install(folder: Path) -> subprocess.CompletedProcess[str]:
    wheels_only = ["--no-index", "--find-links", str(folder)]
    command = [str(ROOT / ".ci/install"), *wheels_only, "--require-hashes", "-r", "tiny.lock"]
    environment = {**os.environ, "PIP_EXTRA_INDEX_URL": f"file://{folder}/absent"}  # pip warns of it
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def is_there(folder: Path) -> bool:
    return (
        subprocess.run([folder / ".venv/bin/python", "-c", "import tiny_wheel"], check=False, capture_output=True).returncode == 0
    )


def test_uv_installs_and_says_so(folder: Path) -> None:
    uv_is(folder)
    done = install(folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("installing tiny.lock\n")
    assert "Installed 1 package" in done.stdout
    assert is_there(folder)


def test_pip_installs_where_uv_cannot(folder: Path) -> None:
    uv_is(folder, "echo error: no such index >&2; exit 2")
    done = install(folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[1].startswith("uv cannot")
    assert "Installing collected packages: tiny-wheel" in done.stdout
    assert not {"error", "warning"} & set(done.stdout.lower().replace(":", " ").split())
    assert "error: no such index" in (folder / ".venv/install.log").read_text()
    assert is_there(folder)


def test_a_wheel_with_another_hash_is_refused_by_both(folder: Path) -> None:
    uv_is(folder)
    lock = (folder / "tiny.lock").read_text()
    (folder / "tiny.lock").write_text(f"{lock.split('sha256:')[0]}sha256:{'0' * 64}\n")
    done = install(folder)
    assert done.returncode == 1
    assert "Hash mismatch" in done.stderr  # uv
    assert "DO NOT MATCH THE HASHES" in done.stderr  # pip
    assert not is_there(folder)
