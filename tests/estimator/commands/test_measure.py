"""landfix measure, as a user runs it."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from calib.files.formats import save_rig
from estimator.cli import app
from tests.vision import roofs
from vision.image.rectify import Image

RIG = roofs.nadir_rig(lens=(-0.12, 0.08, 0.0005, -0.0003), squint_rad=0.004)
VIEW = roofs.view(3, 25.0, rig=RIG)
COLOURS = [x for b, g, r in roofs.COLOURS for x in ("--colour", f"{r},{g},{b}")]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_rig(tmp_path / "rig.yaml", RIG)
    for name, image in (("left.png", VIEW.left), ("right.png", VIEW.right)):
        write(tmp_path / name, image)
    return tmp_path


def write(path: Path, image: Image) -> None:
    path.write_bytes(cv2.imencode(path.suffix, image)[1].tobytes())


def run(folder: Path, *arguments: str, left: str = "left.png", right: str = "right.png") -> tuple[int, str, str]:
    result = CliRunner().invoke(
        app, ["measure", str(folder / left), str(folder / right), "--rig", str(folder / "rig.yaml"), *arguments]
    )
    assert "Traceback" not in result.stderr
    return result.exit_code, result.stdout, result.stderr


def test_the_table_and_the_picture(folder: Path) -> None:
    code, out, _ = run(folder, *COLOURS, "-o", str(folder / "out.png"))
    assert code == 0
    assert all(word in out for word in ("distance m", "width m", "length m", "size m2", "fill ratio", "±", "red", "azure"))
    drawn = cv2.imread(str(folder / "out.png"))
    assert drawn is not None
    assert drawn.shape == (960, 1280, 3)


def test_json_holds_the_true_sizes(folder: Path) -> None:
    """Every whole roof of the rendered world is there, each value within four of its sigmas."""
    code, out, _ = run(folder, *COLOURS, "--json")
    assert code == 0
    found = json.loads(out)
    assert found["problem"] is None
    regions = [r for r in found["regions"] if not r["touches_border"]]
    checked = 0
    for mark, corners in zip(VIEW.landmarks, VIEW.roofs_c, strict=True):
        distance = float(np.linalg.norm(corners.mean(axis=0)))
        for r in regions:
            near = np.linalg.norm(np.array(r["centre_c_m"]) - corners.mean(axis=0)) < 1.0
            if near and r["size_m2"]["value"] > 0.7 * mark.size_m2:
                checked += 1
                for name, true in (("distance_m", distance), ("width_m", mark.width_m), ("size_m2", mark.size_m2)):
                    assert abs(r[name]["value"] - true) < 4.0 * r[name]["sigma"] < 0.5 * true
    assert checked >= 4


def test_swapped_images_are_said(folder: Path) -> None:
    code, _, err = run(folder, *COLOURS, left="right.png", right="left.png")
    assert code == 1
    assert "left and right are swapped" in err.splitlines()[-1]


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("text.png", b"no image", "text.png: no image that can be read"),
        ("empty.png", b"", "empty.png: no image that can be read"),
        ("black.png", None, "right image: black"),
        ("small.png", None, "left is 640 x 480, right is 640 x 100"),
    ],
)
def test_bad_images_give_one_line(folder: Path, name: str, content: bytes | None, reason: str) -> None:
    if content is None:
        write(folder / name, np.zeros_like(VIEW.right) if name == "black.png" else VIEW.right[:100])
    else:
        (folder / name).write_bytes(content)
    code, out, err = run(folder, right=name)
    assert code == 1
    assert reason in err
    assert len(err.strip().splitlines()) == 1
    assert out == ""


def test_missing_files_and_wrong_usage(folder: Path) -> None:
    assert run(folder, right="nowhere.png")[0] == 1
    assert run(folder, "--colour", "red")[0] == 2
    assert run(folder, "--space", "cmyk")[0] == 2
    (folder / "rig.yaml").write_text("nonsense: 3\n")
    code, _, err = run(folder)
    assert code == 1
    assert "rig.yaml" in err
