"""NOAA's own test values of the World Magnetic Model 2025 (WMM2025_TestValues.txt)."""

import numpy as np
import pytest

from models.earth_field import field_n, year_of
from models.frames import Origin

# year, height above the ellipsoid [m], latitude, longitude [deg], north, east, down [nT]
PUBLISHED = [
    (2025.000000, 28000.0, 89, -121, -255.388723, -1482.460628, 56194.288771),
    (2025.000000, 66000.0, 14, 143, 35003.441364, -116.624818, 7966.315182),
    (2025.500000, 22000.0, -37, 140, 21404.761773, 3498.897430, -55397.587760),
    (2026.000000, 47000.0, -72, -22, 18280.800055, -2024.105320, -33397.486160),
    (2026.500000, 44000.0, -46, -42, 13863.176808, -2785.834358, -19744.304022),
    (2027.000000, 37000.0, -66, -5, 16390.771268, -5079.626554, -28608.243575),
    (2027.000000, 61000.0, 59, -77, 10437.775689, -3087.391846, 54397.713552),
    (2027.500000, 96000.0, -46, -85, 18947.658009, 6129.590452, -21631.434316),
    (2028.000000, 30000.0, -36, -64, 17341.333537, -1411.102609, -14639.967305),
    (2028.500000, 39000.0, -65, -88, 17946.905687, 10131.662696, -35982.872979),
    (2029.000000, 95000.0, -60, -59, 17893.018948, 2700.105868, -26011.845842),
    (2029.000000, 41000.0, 42, -19, 24439.977735, -1762.893879, 36929.897501),
    (2029.500000, 18000.0, 9, -172, 30520.999126, 4966.941695, 8779.472279),
]


@pytest.mark.parametrize(("year", "alt_m", "lat", "lon", "north", "east", "down"), PUBLISHED)
def test_the_field_is_the_published_one(
    year: float, alt_m: float, lat: float, lon: float, north: float, east: float, down: float
) -> None:
    np.testing.assert_allclose(np.array(field_n(Origin(lat, lon, alt_m), year)) * 1e9, [north, east, down], atol=0.1)


def test_a_clock_that_was_never_set_has_the_field_of_the_models_time() -> None:
    place = Origin(48.0, 11.0, 500.0)
    assert field_n(place, 1970.0) == field_n(place, 2027.5)
    assert year_of(1_735_689_600 * 10**9) == pytest.approx(2025.0, abs=0.003)
