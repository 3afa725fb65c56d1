"""`landfix run` with one camera over a real Zenoh session: its images alone are published, fixes and estimates come back."""

import time
from pathlib import Path

import numpy as np

from benchmarks.service.vehicle import Vehicle
from calib.files.formats import save_mounted
from estimator.service.zenoh.keys import rmw_key
from logs.wire import schemas
from logs.wire.decoding import Decoder, decode_odometry
from logs.wire.stamps import restamped
from models.messages import ImuSample, LandmarkFix
from tests.estimator.scenes import SECOND, pose_fix
from tests.estimator.service.flying import ODOMETRY, as_process, client, free_port
from tests.estimator.sights import PLACE, village

_FIXES = 3
_PATIENCE_S = 300.0  # a busy machine compiles slowly


def _configuration(folder: Path, port: int) -> str:
    """The camera's file says how it sits on the body; no other camera is waited for."""
    (folder / "map.geojson").write_bytes(village().map.to_geojson())
    save_mounted(folder / "camera.yaml", village().rig)
    return f"""
[map]
landmarks = "map.geojson"
[rig]
file = "camera.yaml"
[inputs]
right_image = []
[pose_fix]
tilt_deg = 0.0
mount_deg = 0.0
[zenoh]
listen = ["tcp/127.0.0.1:{port}"]
[log]
folder = "{folder / "logs"}"
least_free_mb = 0.0
[vision]
timeout_s = 60.0
"""


def test_images_of_one_camera_become_fixes_and_estimates(tmp_path: Path) -> None:
    port, fixes, estimates = free_port(), list[bytes](), list[bytes]()
    with as_process(_configuration(tmp_path, port), tmp_path, port), client(port) as session:
        vehicle = Vehicle(session, seed=0)
        _ = session.declare_subscriber(
            rmw_key(0, "/landfix/fix", schemas.LANDMARK_FIX), lambda sample: fixes.append(sample.payload.to_bytes())
        )
        _ = session.declare_subscriber(
            rmw_key(0, ODOMETRY, schemas.ODOMETRY), lambda sample: estimates.append(sample.payload.to_bytes())
        )
        image, began_ns = village().pairs[0][0], time.time_ns()
        next_ns = began_ns
        while len(fixes) < _FIXES:
            now_ns = time.time_ns()
            assert now_ns - began_ns < _PATIENCE_S * SECOND, "no fix comes"
            vehicle.measure(ImuSample(now_ns, now_ns, (0.0, 0.0, 0.0), (0.0, 0.0, -9.80665)))
            if now_ns >= next_ns:
                if not fixes:  # until the camera sees, somebody else aligns
                    vehicle.measure(pose_fix(now_ns, PLACE))
                vehicle.put(image._replace(data=restamped(image.data, now_ns)))
                next_ns = now_ns + SECOND // 2
            time.sleep(0.01)
    assert vehicle.sent.get("/right/image", 0) == 0
    for data in fixes:
        fix = Decoder().decode("/landfix/fix", schemas.LANDMARK_FIX, data, 0)
        assert isinstance(fix, LandmarkFix)
        assert len(fix.landmarks) >= 2
        assert float(np.linalg.norm(np.subtract(fix.p_n, PLACE))) < 1.5
    assert float(np.linalg.norm(np.subtract(decode_odometry(estimates[-1]).p_n, PLACE))) < 1.5
