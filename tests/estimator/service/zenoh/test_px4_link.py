"""PX4's zenoh module as it hears us: keys, bytes, its own clock, and nothing that it would count twice."""

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from benchmarks.service.vehicle import ORIGIN, RADIUS_M
from estimator.config import parse
from estimator.service.autopilot import px4_messages as px4
from estimator.service.zenoh.keys import attachment
from models import so3
from models.messages import AidStatus, Estimate, Mode, Reason
from models.state import E, X
from tests.estimator.service.flying import client, fly, free_port, in_thread, status, toml, until

SECOND = 1_000_000_000
T0 = 1_795_000_000 * SECOND
STORE = get_typestore(Stores.EMPTY)
for name, text in px4.DEFINITIONS.items():
    STORE.register(get_types_from_msg(text, name))

KEYS = {
    px4.VEHICLE_ODOMETRY: "0/fmu/in/vehicle_visual_odometry/px4_msgs::msg::dds_::VehicleOdometry_/"
    "RIHS01_4295b96ad312084aa35c84bdcec65ba2f57eb4f6a293d57d52d95acbe99ff817",
    px4.AUX_GLOBAL_POSITION: "0/fmu/in/aux_global_position/px4_msgs::msg::dds_::AuxGlobalPosition_/"
    "RIHS01_e7c770fd6c0407ffa97ce9b16ff21f3ae148b2709e7c86658cf40f0a93484589",
    px4.VEHICLE_GLOBAL_POSITION: "0/fmu/in/aux_global_position/px4_msgs::msg::dds_::VehicleGlobalPosition_/"
    "RIHS01_cf9a06f6a8c328f7200984e3aabc0fb76fde3b1fa693baff68ebaf162d2fdc60",
}


def _estimate(t_ns: int = T0, mode: Mode = Mode.AIDED) -> Estimate:
    nav, cov = np.arange(1.0, 17.0), np.diag(np.arange(1.0, 16.0))
    nav[X.Q] = so3.from_euler(0.1, -0.2, 2.0)
    cov[:2, :2] = [[5.0, 3.0], [3.0, 5.0]]
    return Estimate(t_ns, t_ns, nav, cov, (0.1, 0.2, 0.3), mode, 258, t_ns, ORIGIN.lla)


@pytest.mark.parametrize("schema", list(KEYS))
def test_definitions_have_the_hashes_that_px4_has_in_its_keys(schema: str) -> None:
    assert KEYS[schema].endswith(px4.type_hash(schema))
    assert px4.type_hash(schema) == STORE.hash_rihs01(schema)


def test_vehicle_odometry_is_read_as_it_was_meant() -> None:
    e = _estimate()
    data = px4.vehicle_odometry(e, 5_000_000, 4_990_000, 2, 87)
    assert data is not None
    assert len(data) == 118
    read: Any = STORE.deserialize_cdr(data, px4.VEHICLE_ODOMETRY)
    assert bytes(STORE.serialize_cdr(read, px4.VEHICLE_ODOMETRY)) == data
    assert (read.timestamp, read.timestamp_sample, read.pose_frame, read.velocity_frame) == (5_000_000, 4_990_000, 1, 1)
    assert (read.reset_counter, read.quality) == (2, 87)
    np.testing.assert_allclose(read.position, e.nav[X.P], rtol=1e-6)
    np.testing.assert_allclose(read.q, e.nav[X.Q], rtol=1e-6)
    np.testing.assert_allclose(read.velocity, e.nav[X.V], rtol=1e-6)
    np.testing.assert_allclose(read.angular_velocity, e.gyro_b, rtol=1e-6)
    for part, name in ((E.P, "position"), (E.THETA, "orientation"), (E.V, "velocity")):
        np.testing.assert_allclose(getattr(read, f"{name}_variance"), np.diag(e.covariance)[part], rtol=1e-6)


def test_both_kinds_of_fixes_are_read_as_they_were_meant() -> None:
    e, lla = _estimate(), (47.1, 8.2, 500.0)
    aux = px4.aux_global_position(e, lla, 47.5, 7, 6, 3)
    old = px4.vehicle_global_position(e, lla, 47.5, 7, 6)
    assert aux is not None
    assert old is not None
    assert (len(aux), len(old)) == (57, 74)
    for data, schema in ((aux, px4.AUX_GLOBAL_POSITION), (old, px4.VEHICLE_GLOBAL_POSITION)):
        read: Any = STORE.deserialize_cdr(data, schema)
        assert bytes(STORE.serialize_cdr(read, schema)) == data
        assert (read.timestamp, read.timestamp_sample, read.lat, read.lon, read.lat_lon_reset_counter) == (7, 6, 47.1, 8.2, 2)
        assert read.alt == pytest.approx(452.5)
        assert read.eph == pytest.approx(np.sqrt(8.0))  # the longest axis of the ellipse
        assert read.epv == pytest.approx(np.sqrt(3.0))
    assert (STORE.deserialize_cdr(aux, px4.AUX_GLOBAL_POSITION).id, aux[4 + 17]) == (3, 2)  # type: ignore[attr-defined]


def _fused(kind: str, t_ns: int, reason: Reason = Reason.FUSED) -> AidStatus:
    return AidStatus(t_ns, t_ns, f"/{kind}", kind, reason)


class _Px4:
    """The other end: publishes its time, hears us."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._started_ns = time.time_ns() - 1000 * SECOND
        self.heard: list[tuple[str, Any, int]] = []
        self._subscribers = [session.declare_subscriber(key, self._hear(schema)) for schema, key in KEYS.items()]

    def _hear(self, schema: str) -> Any:
        def hear(sample: zenoh.Sample) -> None:
            read = STORE.deserialize_cdr(sample.payload.to_bytes(), schema)
            self.heard.append((schema, read, (time.time_ns() - self._started_ns) // 1000))

        return hear

    def speak(self, now_us: int | None = None) -> None:
        now_us = now_us or (time.time_ns() - self._started_ns) // 1000
        key = "0/fmu/out/vehicle_status/px4_msgs::msg::dds_::VehicleStatus_/RIHS01_0"
        payload = b"\0\1\0\0" + max(0, now_us - 30_000).to_bytes(8, "little")  # its own stamp is older
        self._session.put(key, payload, attachment=attachment(1, now_us, bytes(16)))

    def reboot(self) -> None:
        self._started_ns = time.time_ns() - 5 * SECOND

    def of(self, schema: str) -> list[Any]:
        return [read for name, read, _ in self.heard if name == schema]


@pytest.mark.parametrize("release", ["1.17", "1.18"])
def test_px4_is_reported_in_its_own_time_what_it_does_not_know_itself(tmp_path: Path, release: str) -> None:
    port = free_port()
    text = toml(tmp_path, port) + f'[px4]\nenabled = true\nrelease = "{release}"\nslot = 2\n[autopilot]\ngnss_quiet_s = 1.5\n'
    wanted = px4.AUX_GLOBAL_POSITION if release == "1.18" else px4.VEHICLE_GLOBAL_POSITION
    with in_thread(parse(text), tmp_path), client(port) as session, client(port) as vehicle:
        autopilot = _Px4(session)
        fly(vehicle, 1.5)
        assert autopilot.heard == []  # its clock is not known yet
        for _ in range(5):
            autopilot.speak()
        fly(vehicle, 1.0)
        with_gnss = autopilot.of(px4.VEHICLE_ODOMETRY)
        assert {m.quality for m in with_gnss} - {-1} == {0}  # -1: before its IMU came back
        assert autopilot.of(wanted) == []
        autopilot.speak(5)  # one wild stamp, and nothing to put it right
        autopilot.heard.clear()
        fly(vehicle, 3.0, gnss_hz=0.0)
        without = list(autopilot.heard)
        autopilot.reboot()
        for _ in range(5):
            autopilot.speak()
        until(lambda: status(session).get("px4 reboots") == "1", "the new clock is found")
        autopilot.heard.clear()
        fly(vehicle, 0.5, gnss_hz=0.0)
        rebooted = list(autopilot.heard)
        until(lambda: "px4 fixes" in status(session), "the status reports PX4")
    assert {schema for schema, _, _ in without} == {px4.VEHICLE_ODOMETRY, wanted}
    odometry = [m for schema, m, _ in without if schema == px4.VEHICLE_ODOMETRY and m.quality >= 0]
    fixes = [m for schema, m, _ in without if schema == wanted]
    assert 50 <= len(odometry) <= 110
    assert max(m.quality for m in odometry) > 80
    assert 5 <= len(fixes) <= 15
    for group in (without, rebooted):
        ages_us = [heard_us - m.timestamp_sample for _, m, heard_us in group]
        assert -2_000 < min(ages_us) < 50_000
    lla = ORIGIN.to_geodetic(odometry[-1].position)  # at most half a second, 3 m, later
    assert abs(fixes[-1].lat - lla[0]) < 1e-4
    assert abs(fixes[-1].lon - lla[1]) < 1e-4
    assert np.hypot(*odometry[-1].position[:2]) == pytest.approx(RADIUS_M, abs=1.5)
