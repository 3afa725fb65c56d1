"""The estimate in the autopilot's local frame, against its own way from that frame back to latitude and longitude."""

import math
from typing import Any

import numpy as np
import pytest

from estimator.service.autopilot.local_frame import LocalOrigin
from models import so3
from models.frames import Origin
from models.messages import Estimate, Mode, Vec3
from models.state import X

GEOID_M = 19.5
MAP = Origin(-35.363262, 149.165237, 603.5)
K = 111_318.845_021_450_34


def _estimate(p_n: Vec3, origin: Vec3 | None = MAP.lla, q: Any = (1.0, 0.0, 0.0, 0.0)) -> Estimate:
    nav = np.zeros(16)
    nav[X.P], nav[X.Q] = p_n, q
    return Estimate(1, 1, nav, np.eye(15), (0.0, 0.0, 0.0), Mode.AIDED, 0, 1, origin)


def _heard(lat_deg: float, lon_deg: float, sea_m: float) -> LocalOrigin:
    origin = LocalOrigin()
    origin.hear(lat_deg, lon_deg, sea_m)
    return origin


def _as_ardupilot_reads(lat0: float, lon0: float, sea0: float, p: Vec3) -> Vec3:
    """Location::offset_latlng of a position relative to the origin, and the height above the sea."""
    lat = lat0 + p[0] / K
    return lat, lon0 + p[1] / (K * math.cos(math.radians(0.5 * (lat + lat0)))), sea0 - p[2]


@pytest.mark.parametrize(
    "away_n", [(0.0, 0.0, 0.0), (300.0, -200.0, -20.0), (9000.0, 7000.0, -400.0), (-40_000.0, 60_000.0, 90.0)]
)
@pytest.mark.parametrize("origin_n", [(0.0, 0.0, 0.0), (250.0, 260.0, 5.0), (-20_000.0, 3000.0, 100.0)])
def test_ardupilot_reads_the_position_that_is_sent(away_n: Vec3, origin_n: Vec3) -> None:
    lat0, lon0, ellipsoid0 = MAP.to_geodetic(origin_n)
    lat0, lon0, sea0 = round(lat0, 7), round(lon0, 7), round(ellipsoid0 - GEOID_M, 3)
    pose = _heard(lat0, lon0, sea0).pose(_estimate(away_n), GEOID_M)
    assert pose is not None
    lat, lon, sea = _as_ardupilot_reads(lat0, lon0, sea0, pose[0])
    np.testing.assert_allclose(MAP.to_ned(lat, lon, sea + GEOID_M), away_n, atol=2e-3)


def _as_px4_reads(lat0: float, lon0: float, sea0: float, p: Vec3) -> Vec3:
    """MapProjection::reproject of PX4, R = 6371 km."""
    x, y = p[0] / 6_371_000.0, p[1] / 6_371_000.0
    c, phi0 = math.hypot(x, y), math.radians(lat0)
    if c == 0.0:
        return lat0, lon0, sea0 - p[2]
    lat = math.asin(math.cos(c) * math.sin(phi0) + x * math.sin(c) * math.cos(phi0) / c)
    turn = math.atan2(y * math.sin(c), c * math.cos(phi0) * math.cos(c) - x * math.sin(phi0) * math.sin(c))
    return math.degrees(lat), lon0 + math.degrees(turn), sea0 - p[2]


@pytest.mark.parametrize(
    "away_n", [(0.0, 0.0, 0.0), (300.0, -200.0, -20.0), (9000.0, 7000.0, -400.0), (-40_000.0, 60_000.0, 90.0)]
)
@pytest.mark.parametrize("origin_n", [(0.0, 0.0, 0.0), (250.0, 260.0, 5.0), (-20_000.0, 3000.0, 100.0)])
def test_px4_reads_the_place_that_is_meant(away_n: Vec3, origin_n: Vec3) -> None:
    lat0, lon0, ellipsoid0 = MAP.to_geodetic(origin_n)
    lat0, lon0, sea0 = round(lat0, 7), round(lon0, 7), round(ellipsoid0 - GEOID_M, 3)
    pose = _heard(lat0, lon0, sea0).pose(_estimate(away_n), GEOID_M, is_px4=True)
    assert pose is not None
    lat, lon, sea = _as_px4_reads(lat0, lon0, sea0, pose[0])
    np.testing.assert_allclose(MAP.to_ned(lat, lon, sea + GEOID_M), away_n, atol=2e-3)


def test_360_m_between_the_origins_are_360_m_in_what_is_sent() -> None:
    lat0, lon0, ellipsoid0 = MAP.to_geodetic((-216.0, 288.0, 0.0))
    pose = _heard(lat0, lon0, ellipsoid0 - GEOID_M).pose(_estimate((0.0, 0.0, -10.0)), GEOID_M)
    assert pose is not None
    np.testing.assert_allclose(pose[0], (216.0, -288.0, -10.0), atol=1.0)  # but for the 0.3 % of its sphere
    np.testing.assert_allclose(pose[1], (1.0, 0.0, 0.0, 0.0), atol=1e-4)


def test_across_the_date_line_it_is_near() -> None:
    origin = Origin(10.0, 179.9999, 0.0)
    pose = _heard(10.0, -179.9999, 0.0).pose(_estimate((0.0, 0.0, 0.0), origin.lla), 0.0)
    assert pose is not None
    np.testing.assert_allclose(pose[0], (0.0, -0.0002 * K * math.cos(math.radians(10.0)), 0.0), atol=0.01)


def test_north_and_down_are_those_of_where_the_vehicle_is() -> None:
    """100 km east of the map's origin at 60 degrees of latitude the meridians have turned by 100 km / 6390 km tan(60 deg)."""
    origin = Origin(60.0, 10.0, 0.0)
    pose = _heard(60.0, 10.0, 0.0).pose(_estimate((0.0, 100_000.0, 0.0), origin.lla), 0.0)
    assert pose is not None
    roll, pitch, yaw = so3.to_euler(pose[1])
    assert yaw == pytest.approx(100.0 / 6395.0 * math.tan(math.radians(60.0)), rel=0.01)  # the north there is west of it
    assert abs(roll) == pytest.approx(100.0 / 6395.0, rel=0.01)
    assert pitch == pytest.approx(0.0, abs=5e-4)


def test_without_either_origin_there_is_no_pose() -> None:
    assert LocalOrigin().pose(_estimate((0.0, 0.0, 0.0)), GEOID_M) is None
    heard = _heard(*MAP.lla)
    assert heard.pose(_estimate((0.0, 0.0, 0.0), None), GEOID_M) is None
    heard.forget()
    assert heard.pose(_estimate((0.0, 0.0, 0.0)), GEOID_M) is None


@pytest.mark.parametrize(
    "place", [(0.0, 0.0, 0.0), (91.0, 1.0, 0.0), (1.0, 180.1, 0.0), (math.nan, 1.0, 0.0), (1.0, 1.0, math.nan)]
)
def test_what_is_no_place_is_refused(place: Vec3) -> None:
    origin = _heard(*MAP.lla)
    before = origin.place
    with pytest.raises(ValueError, match="no place"):
        origin.hear(*place)
    assert origin.place == before
