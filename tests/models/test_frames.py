"""The world against the ellipsoid's own formulas, written out here, and published values."""

import math

import numpy as np
import pytest

from models import so3
from models.frames import EARTH_RATE, ENU_FROM_NED, FLU_FROM_FRD, Origin, normal_gravity
from models.messages import Array

A = 6_378_137.0  # m, WGS-84 semi-major axis
F = 1 / 298.257223563  # WGS-84 flattening
E2 = F * (2 - F)  # first eccentricity squared
ORIGINS = [
    Origin(0.0, 0.0, 0.0),
    Origin(47.397742, 8.545594, 488.0),
    Origin(-33.8688, 151.2093, 20.0),
    Origin(69.6, -179.9999, 0.0),
]


def _ecef(lat_deg: float, lon_deg: float, alt_m: float) -> Array:
    """Cartesian position in e [m] (Groves 2013, eq. 2.112)."""
    lat, lon = math.radians(lat_deg), math.radians(lon_deg)
    n = A / math.sqrt(1 - E2 * math.sin(lat) ** 2)
    across = (n + alt_m) * math.cos(lat)
    return np.array([across * math.cos(lon), across * math.sin(lon), (n * (1 - E2) + alt_m) * math.sin(lat)])


def _R_ne(origin: Origin) -> Array:
    """ECEF -> NED at the origin (Groves 2013, eq. 2.150)."""
    lat, lon = math.radians(origin.lat_deg), math.radians(origin.lon_deg)
    s, c, sl, cl = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    return np.array([[-s * cl, -s * sl, c], [-sl, cl, 0.0], [-c * cl, -c * sl, -s]])


@pytest.mark.parametrize("origin", ORIGINS)
@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (1e-6, -1e-6, 0.01), (0.01, 0.02, 150.0), (-0.5, 0.7, 3000.0)])
def test_to_ned_is_the_ecef_difference_turned(origin: Origin, offset: tuple[float, float, float]) -> None:
    place = (origin.lat_deg + offset[0], origin.lon_deg + offset[1], origin.alt_m + offset[2])
    expected = _R_ne(origin) @ (_ecef(*place) - _ecef(origin.lat_deg, origin.lon_deg, origin.alt_m))
    np.testing.assert_allclose(origin.to_ned(*place), expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize("origin", ORIGINS)
@pytest.mark.parametrize("p_n", [(0.0, 0.0, 0.0), (1e-3, -1e-3, 1e-3), (1200.0, -800.0, -120.0), (-40_000.0, 30_000.0, -5_000.0)])
def test_to_geodetic_undoes_to_ned(origin: Origin, p_n: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(origin.to_ned(*origin.to_geodetic(p_n)), p_n, rtol=0, atol=1e-6)


def test_axes_point_north_east_down() -> None:
    origin = ORIGINS[1]
    lat, lon, alt = origin.lat_deg, origin.lon_deg, origin.alt_m
    assert origin.to_ned(lat + 1e-3, lon, alt)[0] == pytest.approx(111.2, abs=0.1)  # a thousandth of a degree of latitude
    assert origin.to_ned(lat, lon + 1e-3, alt)[1] == pytest.approx(75.5, abs=0.1)  # 111.4 m cos(47.4 deg)
    assert origin.to_ned(lat, lon, alt + 10.0)[2] == pytest.approx(-10.0, abs=1e-6)


def test_the_ground_falls_away_from_the_tangent_plane() -> None:
    """d^2 / 2R: 10 km away the ellipsoid lies 7.8 m below n's horizon."""
    origin = Origin(0.0, 0.0, 0.0)
    angle = 10_000.0 / A
    np.testing.assert_allclose(
        origin.to_ned(0.0, math.degrees(angle), 0.0), [0.0, A * math.sin(angle), A * (1 - math.cos(angle))], rtol=0, atol=1e-8
    )


@pytest.mark.parametrize(
    ("lat_deg", "expected"),
    [(0.0, 9.7803253359), (45.0, 9.8061992), (90.0, 9.8321849379)],  # at 45 degrees GRS80, 1.4e-6 apart
    ids=["equator", "45 degrees", "pole"],
)
def test_gravity_on_the_ellipsoid_has_its_published_values(lat_deg: float, expected: float) -> None:
    for side in (1.0, -1.0):
        assert normal_gravity(math.radians(side * lat_deg), 0.0) == pytest.approx(expected, abs=2e-6)


@pytest.mark.parametrize("alt_m", [-100.0, 500.0, 3000.0])
@pytest.mark.parametrize("lat_deg", [0.0, 47.4, 80.0])
def test_gravity_falls_with_height_as_the_full_expansion_does(lat_deg: float, alt_m: float) -> None:
    """Against Groves 2013, eq. 2.139, with all its terms: 0.1 mm/s^2 up to 3 km."""
    ground = normal_gravity(math.radians(lat_deg), 0.0)
    m = EARTH_RATE**2 * A**2 * 6_356_752.31425 / 3.986004418e14
    full = ground * (1 - 2 / A * (1 + F * (1 - 2 * math.sin(math.radians(lat_deg)) ** 2) + m) * alt_m + 3 * (alt_m / A) ** 2)
    assert normal_gravity(math.radians(lat_deg), alt_m) == pytest.approx(full, abs=1e-4)
    assert (normal_gravity(math.radians(lat_deg), alt_m) - ground) / alt_m == pytest.approx(-3.08e-6, abs=0.02e-6)


@pytest.mark.parametrize("origin", ORIGINS)
def test_origin_has_the_gravity_of_its_place(origin: Origin) -> None:
    assert origin.gravity == normal_gravity(math.radians(origin.lat_deg), origin.alt_m)


@pytest.mark.parametrize("origin", ORIGINS)
def test_earth_rate_lies_along_the_polar_axis(origin: Origin) -> None:
    np.testing.assert_allclose(origin.earth_rate_n, _R_ne(origin) @ np.array([0.0, 0.0, EARTH_RATE]), rtol=0, atol=1e-18)


def test_earth_turns_once_in_a_sidereal_day() -> None:
    assert 2 * math.pi / EARTH_RATE == pytest.approx(86_164.1, abs=0.1)


@pytest.mark.parametrize("swap", [ENU_FROM_NED, FLU_FROM_FRD])
def test_frame_changes_are_rotations_and_their_own_inverse(swap: Array) -> None:
    np.testing.assert_array_equal(swap @ swap, np.eye(3))
    assert np.linalg.det(swap) == pytest.approx(1.0)


def test_ned_becomes_enu_and_frd_becomes_flu() -> None:
    np.testing.assert_array_equal(ENU_FROM_NED @ np.array([1.0, 2.0, 3.0]), [2.0, 1.0, -3.0])
    np.testing.assert_array_equal(FLU_FROM_FRD @ np.array([1.0, 2.0, 3.0]), [1.0, -2.0, -3.0])


@pytest.mark.parametrize(("heading_deg", "ros_yaw_deg"), [(0.0, 90.0), (90.0, 0.0), (180.0, -90.0)])
def test_heading_north_is_a_quarter_turn_in_ros(heading_deg: float, ros_yaw_deg: float) -> None:
    """R_enu_flu = ENU_FROM_NED R_nb FLU_FROM_FRD (REP-103: yaw 0 looks east, counted anticlockwise)."""
    R_nb = so3.matrix(so3.from_euler(0.0, 0.0, math.radians(heading_deg)))
    roll, pitch, yaw = so3.to_euler(so3.from_matrix(np.ascontiguousarray(ENU_FROM_NED @ R_nb @ FLU_FROM_FRD)))
    np.testing.assert_allclose([roll, pitch], 0.0, atol=1e-12)
    assert math.degrees(yaw) == pytest.approx(ros_yaw_deg, abs=1e-9)


def test_origin_of_a_tuple_or_of_nothing() -> None:
    assert Origin.of((1.0, 2.0, 3.0)) == Origin(1.0, 2.0, 3.0)
    assert Origin.of(None) is None
