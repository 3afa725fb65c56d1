"""PX4's zenoh module as it hears us: keys, bytes, its own clock, and nothing that it would count twice."""

import inspect
import math
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from benchmarks.service.vehicle import ORIGIN, RADIUS_M, SPEED_M_S
from estimator.config import parse
from estimator.service.autopilot import px4_messages as px4
from estimator.service.zenoh.keys import attachment
from models import so3
from models.messages import AidStatus, Estimate, Mode, Reason
from models.state import E, X
from tests import long
from tests.estimator.service.flying import client, fly, free_port, in_thread, status, toml, until

SECOND = 1_000_000_000
GEOID_M = 47.5
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


LOCAL_POSITION_KEY = (
    "0/fmu/out/vehicle_local_position/px4_msgs::msg::dds_::VehicleLocalPosition_/"
    "RIHS01_690ad535169297241c696494adbd98bbdc45566645026fe7963513a29a1bf144"
)


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
    q_local = so3.from_euler(0.1, -0.2, 2.1)  # the north there is 0.1 rad away from ours
    data = px4.vehicle_odometry(e, ((301.0, -99.0, 7.0), q_local), 5_000_000, 4_990_000, 2, 87)
    assert data is not None
    assert len(data) == 118
    read: Any = STORE.deserialize_cdr(data, px4.VEHICLE_ODOMETRY)
    assert bytes(STORE.serialize_cdr(read, px4.VEHICLE_ODOMETRY)) == data
    assert (read.timestamp, read.timestamp_sample, read.pose_frame, read.velocity_frame) == (5_000_000, 4_990_000, 1, 1)
    assert (read.reset_counter, read.quality) == (2, 87)
    np.testing.assert_allclose(read.position, (301.0, -99.0, 7.0), rtol=1e-6)
    np.testing.assert_allclose(read.q, q_local, rtol=1e-6)
    in_body = so3.matrix(e.nav[X.Q]).T @ e.nav[X.V]
    np.testing.assert_allclose(so3.matrix(np.array(read.q, dtype=float)).T @ read.velocity, in_body, rtol=1e-5)
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

    def say_where(self, lat: float, lon: float, sea_m: float) -> None:
        """A VehicleLocalPosition with this reference, NaN: with none; by the names of its fields."""
        known = not math.isnan(lat)
        now_us = (time.time_ns() - self._started_ns) // 1000
        fields = inspect.signature(STORE.types[px4.VEHICLE_LOCAL_POSITION]).parameters
        values: dict[str, Any] = dict.fromkeys((name for name in fields if name != "__msgtype__"), 0)
        values |= {"delta_xy": np.zeros(2, np.float32), "delta_vxy": np.zeros(2, np.float32), "timestamp": now_us}
        values |= {"xy_global": known, "z_global": known, "ref_lat": lat, "ref_lon": lon, "ref_alt": sea_m, "x": 55.0, "eph": 3.0}
        values |= dict.fromkeys(("dist_bottom_valid", "heading_good_for_control"), True)
        message = STORE.types[px4.VEHICLE_LOCAL_POSITION](
            **{k: v for k, v in values.items() if k in fields and k != "__msgtype__"}
        )
        payload = bytes(STORE.serialize_cdr(message, px4.VEHICLE_LOCAL_POSITION))
        self._session.put(LOCAL_POSITION_KEY, payload, attachment=attachment(1, now_us, bytes(16)))

    def reboot(self) -> None:
        self._started_ns = time.time_ns() - 5 * SECOND

    def of(self, schema: str) -> list[Any]:
        return [read for name, read, _ in self.heard if name == schema]


@long.parametrize("release", ["1.18", "1.17"])
def test_px4_is_reported_in_its_own_time_what_it_does_not_know_itself(tmp_path: Path, release: str) -> None:
    port = free_port()
    keys = f'enabled = true\nrelease = "{release}"\nslot = 2\norigin = "map"\n'
    text = f"{toml(tmp_path, port)}[px4]\n{keys}[autopilot]\ngnss_quiet_s = 1.5\n"
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


def test_odometry_counts_from_the_origin_that_px4_has_itself(tmp_path: Path) -> None:
    """The vehicle circles about our origin; EKF2 has its own 250 m north, 180 m west and 12 m above it."""
    port, there, elsewhere = free_port(), (250.0, -180.0, -12.0), (-250.0, 0.0, 0.0)
    own = "[autopilot]\nown_gnss = false\n"
    text = toml(tmp_path, port).replace("[zenoh]", f"geoid_m = {GEOID_M}\n[zenoh]", 1) + "[px4]\nenabled = true\n" + own
    with in_thread(parse(text), tmp_path), client(port) as session, client(port) as vehicle:
        autopilot = _Px4(session)
        for _ in range(5):
            autopilot.speak()
        fly(vehicle, 1.5)
        unknown = _sent(autopilot, vehicle, None)
        nowhere = _sent(autopilot, vehicle, (math.nan, math.nan, math.nan))
        implausible = _sent(autopilot, vehicle, (200.0, 0.0, 0.0))
        known = _sent(autopilot, vehicle, _place(there))
        moved = _sent(autopilot, vehicle, _place(elsewhere))
        time.sleep(3.1)
        silent = _sent(autopilot, vehicle, None)
        until(lambda: status(session).get("px4 quality") == "-1", "the status reports PX4")
        said = status(session)
    for group in (unknown, nowhere, implausible, silent):
        assert {m.quality for m in group} == {-1}
    _assert_circle(known, there)
    _assert_circle(moved, elsewhere)
    assert known[-1].reset_counter != moved[-1].reset_counter
    assert int(said["px4 implausible_references"]) > 0
    assert said["px4 ekf_origin"] == "not known: ODOMETRY has quality -1"


def test_without_gnss_px4_begins_where_we_do_if_so_configured(tmp_path: Path) -> None:
    port = free_port()
    text = toml(tmp_path, port) + '[px4]\nenabled = true\norigin = "map"\n[autopilot]\nown_gnss = false\n'
    with in_thread(parse(text), tmp_path), client(port) as session, client(port) as vehicle:
        autopilot = _Px4(session)
        for _ in range(5):
            autopilot.speak()
        fly(vehicle, 1.5)
        ours = _sent(autopilot, vehicle, None)
        theirs = _sent(autopilot, vehicle, ORIGIN.to_geodetic((0.0, 300.0, 0.0)))
        time.sleep(3.1)
        silent = _sent(autopilot, vehicle, None)
    _assert_circle(ours, (0.0, 0.0, 0.0))
    _assert_circle(theirs, (0.0, 300.0, 0.0))  # it has one after all: that counts
    assert {m.quality for m in silent} == {-1}  # not back to ours, 300 m away


def test_beyond_the_most_radius_px4_is_told_the_velocity_alone(tmp_path: Path) -> None:
    port = free_port()
    text = toml(tmp_path, port) + '[px4]\nenabled = true\norigin = "map"\n[autopilot]\nown_gnss = false\nmost_radius_m = 0.1\n'
    with in_thread(parse(text), tmp_path), client(port) as session, client(port) as vehicle:
        autopilot = _Px4(session)
        for _ in range(5):
            autopilot.speak()
        fly(vehicle, 1.5)
        of_use = [m for m in _sent(autopilot, vehicle, None) if m.quality >= 0]
    assert len(of_use) > 2
    for m in of_use:
        assert np.isnan(m.position).all()
        assert np.hypot(*m.velocity[:2]) == pytest.approx(SPEED_M_S, abs=1.0)  # the most that its quality allows


def _place(p_n: tuple[float, float, float]) -> tuple[float, float, float]:
    lat, lon, ellipsoid = ORIGIN.to_geodetic(p_n)
    return lat, lon, ellipsoid - GEOID_M


def _sent(autopilot: _Px4, vehicle: zenoh.Session, where: tuple[float, float, float] | None) -> list[Any]:
    """The odometry of some seconds of flight, while PX4 says ten times a second where its frame begins."""
    done = threading.Event()

    def speak() -> None:
        while where is not None and not done.wait(0.1):
            autopilot.say_where(*where)

    thread = threading.Thread(target=speak)
    thread.start()
    time.sleep(0.3)
    autopilot.heard.clear()
    heard: list[Any] = []
    for _ in range(10):  # a busy machine sends fewer
        fly(vehicle, 1.0)
        heard = autopilot.of(px4.VEHICLE_ODOMETRY)
        if len(heard) > 10:
            break
    done.set()
    thread.join()
    assert len(heard) > 10
    return heard


def _assert_circle(messages: list[Any], origin_n: tuple[float, float, float]) -> None:
    """Its positions and the origin add up to the circle that is flown; PX4's sphere is 0.3 % off at most.

    Between two flights the IMU is silent, for seconds on a busy machine: the first position after it is off by as
    much as its variance says.
    """
    of_use = [m for m in messages if m.quality >= 0]
    assert len(of_use) > 2  # the first ones are from before its IMU came back
    p = np.array([m.position for m in of_use]) + origin_n
    sigma = np.sqrt([max(m.position_variance[:2]) for m in of_use])
    off = np.abs(np.hypot(p[:, 0], p[:, 1]) - RADIUS_M)
    assert sigma[-1] < 0.5
    assert (off <= 1.5 + 0.003 * np.hypot(*origin_n[:2]) + 2.0 * sigma).all(), (off, sigma)
