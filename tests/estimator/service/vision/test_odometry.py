"""Visual odometry in its own process."""

import time
from pathlib import Path

import numpy as np
import pytest

from calib.files.formats import save_rig
from estimator.frontend.key_frames import VisualOdometryConfig
from estimator.frontend.odometry import ODOMETRY_REPORT_TOPIC
from estimator.frontend.requests import Track, VisionConfig
from estimator.service.base.clock import Clock, ClockConfig, Stamps
from estimator.service.base.ports import Arrival
from estimator.service.vision.odometry import OdometryWorker
from logs.wire.codec import ODOMETRY_REQUEST_TOPIC, Encoded
from logs.wire.images import encode_image
from models import so3
from models.messages import ODOMETRY_DELTA_TOPIC, Estimate, Mode
from models.state import E, X
from tests.vision.odometry import scene


@pytest.mark.long
def test_it_answers_with_increments(tmp_path: Path) -> None:
    """Two pairs 1 s apart while the estimate moves as they do: request, report and increment; one pair alone asks nothing."""
    save_rig(tmp_path / "rig.yaml", scene.RIG)
    clock, track, heard = Clock(), Track(), list[Encoded]()
    config, patient = VisualOdometryConfig(enabled=True, longest_s=60.0), VisionConfig(timeout_s=120.0)
    sides = {"/left/image": "left", "/right/image": "right"}
    worker = OdometryWorker(
        tmp_path / "rig.yaml", config, patient, sides, clock, Stamps(clock, ClockConfig()), track, heard.append
    )
    try:
        end_s = time.monotonic() + 180.0
        while worker.report()["state"] == "starting" and time.monotonic() < end_s:
            time.sleep(0.02)
        t0_ns = clock.now_ns()
        for k in range(12):  # the pairs' own motion takes the second from t0_ns
            t_ns = t0_ns + (k - 1) * 100_000_000
            share = (k - 1) / 10.0
            nav = np.zeros(X.SIZE)
            nav[X.P], nav[X.V] = scene.P_N[0] + share * (scene.P_N[1] - scene.P_N[0]), scene.P_N[1] - scene.P_N[0]
            turn = so3.quat_log(so3.from_matrix(np.ascontiguousarray(scene.R_NB[0].T @ scene.R_NB[1])))
            q_0 = so3.from_matrix(np.ascontiguousarray(scene.R_NB[0]))
            nav[X.Q] = so3.multiply(q_0, so3.quat_exp(share * turn))
            gyro = (float(turn[0]), float(turn[1]), float(turn[2]))
            covariance = np.diag(np.full(E.SIZE, 1e-4))
            track.note([Estimate(t_ns, t_ns, nav, covariance, gyro, Mode.AIDED, 0, t_ns)])
        for k in (0, 1):
            while clock.now_ns() < t0_ns + k * 1_000_000_000:
                time.sleep(0.01)
            for topic, image in zip(sides, scene.pair(k), strict=True):
                said = encode_image(t0_ns + k * 1_000_000_000, image, topic)
                worker.put(Arrival(said.topic, said.schema, said.data, clock.now_ns()))
        while len(heard) < 3 and time.monotonic() < end_s:
            time.sleep(0.02)
        assert [m.topic for m in heard] == [ODOMETRY_REQUEST_TOPIC, ODOMETRY_REPORT_TOPIC, ODOMETRY_DELTA_TOPIC]
        assert worker.report()["restarts"] == 0
    finally:
        worker.close()
