"""A vehicle at rest above a rendered village, looking down: what tests of vision in the estimator share."""

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.files.formats import save_rig
from logs.store.recorder import Recorder
from logs.wire.codec import Encoded, encode_input
from logs.wire.images import encode_image
from models.camera import StereoRig
from models.maps.landmarks import LandmarkMap
from models.messages import PoseFix
from models.sim.scenario import EPOCH_NS
from tests.estimator.scenes import SECOND, hover
from vision.synthetic import Conditions, WorldSpec, make_world, render_pair

PLACE = (0.0, 0.0, -75.0)
SPEC = WorldSpec(area_m=120.0, painted=1.0, flat=0.0, trees=0.0, sigma_m=0.05, height_sigma_m=0.05)
SEEN_S = (6.0, 6.5, 7.0, 7.5)  # when images are taken; pose fixes end before
ALIGNED_S = 5.0


class Village(NamedTuple):
    """The map and rig of vision, and pairs of images taken at PLACE, level, heading north."""

    rig: StereoRig
    map: LandmarkMap
    pairs: tuple[tuple[Encoded, Encoded], ...]


@cache
def village() -> Village:
    """Rendered once."""
    scene, rng = make_world(2, SPEC), np.random.default_rng(0)
    pairs = []
    for seen_s in SEEN_S:
        t_ns = EPOCH_NS + round(seen_s * SECOND)
        left, right = render_pair(scene.world, scene.rig, np.array(PLACE), np.eye(3), Conditions(), rng)
        pairs.append((encode_image(t_ns, left, "/left/image"), encode_image(t_ns, right, "/right/image", jpeg_quality=95)))
    return Village(scene.rig_calibrated, scene.map, tuple(pairs))


def write_flight(folder: Path) -> tuple[Path, Path]:
    """flight.mcap and the configuration beside it: aligned by pose fixes, then images only."""
    seen = village()
    (folder / "map.geojson").write_bytes(seen.map.to_geojson())
    save_rig(folder / "rig.yaml", seen.rig)
    config = folder / "flight.toml"
    config.write_text('[map]\nlandmarks = "map.geojson"\n[rig]\nfile = "rig.yaml"\n[pose_fix]\ntilt_deg = 0.0\nmount_deg = 0.0\n')
    last_ns = EPOCH_NS + round(ALIGNED_S * SECOND)
    messages = [
        (m.arrived_ns, encode_input(m)) for m in hover(9.0, place=PLACE) if not (isinstance(m, PoseFix) and m.t_ns > last_ns)
    ]
    for seen_s, pair in zip(SEEN_S, seen.pairs, strict=True):
        messages += [(EPOCH_NS + round((seen_s + 0.02) * SECOND), image) for image in pair]
    with Recorder(folder / "flight.mcap") as recorder:
        for arrived_ns, message in sorted(messages, key=lambda item: item[0]):
            recorder.write(*message, arrived_ns)
    return folder / "flight.mcap", config
