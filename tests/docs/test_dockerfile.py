"""The Dockerfile is not built here: what it copies exists, passes .dockerignore and makes the wheel."""

import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
LINES = (ROOT / "Dockerfile").read_text().replace("\\\n", " ").splitlines()
ALLOWED = [line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")]


def instructions(name: str) -> list[str]:
    return [line.removeprefix(name).strip() for line in LINES if line.startswith(f"{name} ")]


def test_the_context_makes_the_wheel(tmp_path: Path) -> None:
    context = tmp_path / "src"
    context.mkdir()
    for name in ALLOWED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, context / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, context / name)
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(command, cwd=context, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    assert {"landfix/__init__.py", "estimator/cli.py", "estimator/tools/demo.toml", "estimator/map_files/egm96.png"} <= names
    assert not [n for n in names if n.startswith(("tests/", "benchmarks/", "docs/"))]


def test_both_stages_have_one_base_and_the_last_one_runs_as_nobody_in_particular() -> None:
    bases = [line.partition(" AS ")[0] for line in instructions("FROM")]
    assert len(bases) == 2
    assert len(set(bases)) == 1
    assert re.fullmatch(r"python:3\.1[1-9]-slim-\w+", bases[0])
    assert instructions("USER")[-1].isdigit()
    assert instructions("USER")[-1] != "0"
    assert instructions("ENTRYPOINT") == ['["landfix"]']


def test_what_it_copies_from_here_passes_the_ignore_file() -> None:
    sources = [line.split()[0] for line in instructions("COPY") if not line.startswith("--from")]
    assert sources == ["requirements-flight.lock", "."]
    assert sources[0] in ALLOWED
    assert all((ROOT / name).exists() for name in ALLOWED)
