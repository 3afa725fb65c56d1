"""How fast the renderer is: stereo pairs on one core, by height, with what an image holds next to it.

The aim is >= 25 VGA pairs/s (40 ms a pair) with 3 to 12 landmarks in view. Nothing is asserted about time.
"""

import time

import cv2
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from models import so3
from vision.synthetic import Conditions, WorldSpec, make_rig, make_world, render_labels, render_pair

pytestmark = pytest.mark.benchmark(timer=time.process_time, warmup=False)

RIGS = {"640x480": make_rig(), "1280x720": make_rig(1280, 720, 900.0)}
SCENES = {  # height above ground, distance of buildings: 3 to 12 landmarks in view at 640 x 480
    "30 m": (30.0, 12.0),
    "60 m": (60.0, 22.0),
    "120 m": (120.0, 40.0),
}


@pytest.mark.parametrize("blur", [False, True], ids=["sharp", "blurred"])
@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("size", RIGS)
def test_pair(benchmark: BenchmarkFixture, size: str, scene: str, blur: bool) -> None:
    cv2.setNumThreads(1)
    height, spacing = SCENES[scene]
    made = make_world(4, WorldSpec(spacing_m=spacing, area_m=8.0 * spacing, rig=RIGS[size]))
    conditions = Conditions(blur_px=(3.0, 1.5) if blur else (0.0, 0.0), haze_per_m=5e-4)
    R_nb, p_n = so3.matrix(so3.from_euler(0.03, 0.1, 0.8)), np.array([2.0, 3.0, -height])
    labels = render_labels(made.world, made.rig.left, *made.rig.camera_pose(p_n, R_nb))
    shown = np.unique(labels)
    benchmark.extra_info["landmarks in view"] = int(np.sum((shown >= 0) & (shown < len(made.world.landmarks))))
    benchmark.extra_info["solids in view"] = int(np.sum(shown >= 0))
    left, _ = render_pair(made.world, made.rig, p_n, R_nb, conditions, np.random.default_rng(0))
    benchmark.extra_info["SIFT keypoints"] = len(cv2.SIFT.create().detect(cv2.cvtColor(left, cv2.COLOR_BGR2GRAY)))
    benchmark.pedantic(  # type: ignore[no-untyped-call]
        lambda: render_pair(made.world, made.rig, p_n, R_nb, conditions, np.random.default_rng(0)), rounds=15
    )
