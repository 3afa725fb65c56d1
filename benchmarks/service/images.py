"""What the cameras of benchmarks.service.vehicle see on one turn of its circle, rendered beforehand.

    python -m benchmarks.service.images FOLDER

It writes turn.mcap (300 stereo pairs, JPEG), map.geojson and rig.yaml.
"""

import multiprocessing
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from benchmarks.service.vehicle import ORIGIN, PERIOD_NS, truth
from calib.files.formats import save_rig
from logs.store.recorder import Recorder
from logs.wire.codec import Encoded
from logs.wire.images import encode_image
from vision.synthetic import Conditions, Scene, WorldSpec, make_world, render_pair

PAIRS: Final = 300  # a turn of 30 s at 10 Hz
_SPEC: Final = WorldSpec(
    area_m=130.0,
    spacing_m=16.0,
    painted=0.8,
    unmapped=0.1,
    sigma_m=0.1,
    height_sigma_m=0.1,
    outline_sigma_m=0.05,
    origin=ORIGIN.lla,
)  # fmt: skip
_JPEG_QUALITY: Final = 90


def write(folder: Path, pairs: int = PAIRS) -> None:
    """Render the turn on all cores."""
    scene = _scene()
    (folder / "map.geojson").write_bytes(scene.map.to_geojson())
    save_rig(folder / "rig.yaml", scene.rig_calibrated)
    with Recorder(folder / "turn.mcap") as recorder:
        for t_ns, pair in _drawn([k * PERIOD_NS // pairs for k in range(pairs)]):
            for message in pair:
                recorder.write(*message, t_ns)


def _drawn(times_ns: list[int]) -> Iterator[tuple[int, tuple[Encoded, Encoded]]]:
    with ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("spawn")) as pool:
        yield from zip(times_ns, pool.map(_draw, times_ns, chunksize=10), strict=True)


@cache
def _scene() -> Scene:
    cv2.setNumThreads(1)
    return make_world(5, _SPEC)


def _draw(t_ns: int) -> tuple[Encoded, Encoded]:
    scene = _scene()
    p_n, _, R_nb = truth(t_ns)
    left, right = render_pair(scene.world, scene.rig, p_n, R_nb, Conditions(), np.random.default_rng(t_ns))
    return (
        encode_image(t_ns, left, "/left/image", jpeg_quality=_JPEG_QUALITY),
        encode_image(t_ns, right, "/right/image", jpeg_quality=_JPEG_QUALITY),
    )


if __name__ == "__main__":
    write(Path(sys.argv[1]))
