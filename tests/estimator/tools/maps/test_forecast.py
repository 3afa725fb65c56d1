"""A route over houses that all differ is fit; over bare ground, and over equal houses, it is not, and the reason is given."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from estimator.cli import app
from estimator.config import Config
from estimator.tools.maps.forecast import Camera, forecast
from estimator.tools.maps.route import HOVER_S, RATE_HZ, fly, read
from models.frames import GRAVITY, Origin
from models.maps.landmarks import Landmark, LandmarkMap
from models.maps.table import MapError
from models.messages import Array

ORIGIN = (47.4, 8.5, 400.0)


def houses(side: Callable[[int], float]) -> LandmarkMap:
    """Each 40 m on both sides of the way north, from 0 to 400 m; none from 400 to 800 m."""
    made = []
    for k in range(11):
        for left in (-1, 1):
            a, b, n, e = side(2 * k + (left > 0)), 8.0, 40.0 * k, 25.0 * left
            ring = [(n, e), (n, e + b), (n + a, e + b), (n + a, e)]
            made.append(Landmark.of(f"{k}{'l' if left < 0 else 'r'}", ring, height_m=5.0, sigma_m=1.0, height_sigma_m=1.0))
    return LandmarkMap.from_landmarks(ORIGIN, made)


def places(*north_east: tuple[float, float]) -> Array:
    return np.array([Origin(*ORIGIN).to_geodetic((n, e, 0.0))[:2] for n, e in north_east])


NORTH = places((0.0, 0.0), (800.0, 0.0))


def test_where_houses_differ_the_radius_stays_small_and_beyond_them_it_grows() -> None:
    flight = fly(NORTH, Origin(*ORIGIN), 80.0, 8.0)
    result = forecast(houses(lambda k: 9.0 + 1.6 * k), flight, Config().fusion(), Camera(), 20.0)
    over = [row.radius95_m for row in result.rows if 100.0 < row.way_m < 380.0]
    assert max(over) < 10.0
    assert not result.fit
    (stretch,) = result.unfit
    assert stretch.reason == "no landmark in view"
    assert stretch.to_m == pytest.approx(800.0, abs=10.0)
    assert stretch.from_m > 450.0
    assert result.worst_radius95_m == max(row.radius95_m for row in result.rows)
    assert {row.state for row in result.rows if row.way_m > 480.0} == {"none"}


@pytest.mark.long
def test_equal_houses_give_no_fix_once_the_radius_is_half_their_distance() -> None:
    """With few fixes, the radius grows between them: where houses differ the next one brings it back."""
    flight = fly(places((0.0, 0.0), (400.0, 0.0)), Origin(*ORIGIN), 80.0, 8.0)
    different, equal = (
        forecast(houses(side), flight, Config().fusion(), Camera(found=0.2), 20.0)
        for side in (lambda k: 6.0 * 1.3 ** (k % 9), lambda _: 12.0)
    )
    assert {row.state for row in equal.rows if row.in_view and row.radius95_m > 26.0} == {"alike"}
    assert "fix" in {row.state for row in different.rows if row.in_view and row.radius95_m > 26.0}
    assert equal.fixes < different.fixes
    assert equal.unfit[-1].reason == "landmarks in view may be taken for others"


def test_the_limit_decides_what_is_fit() -> None:
    the_map = houses(lambda k: 9.0 + 1.6 * k)
    short = fly(places((0.0, 0.0), (160.0, 0.0)), Origin(*ORIGIN), 80.0, 8.0)
    assert forecast(the_map, short, Config().fusion(), Camera(found=1.0), 20.0).fit
    assert not forecast(the_map, short, Config().fusion(), Camera(found=1.0), 0.5).fit


def test_the_flight_is_a_motion_whose_force_is_that_of_its_path() -> None:
    flight = fly(places((0.0, 0.0), (0.0, 300.0), (200.0, 300.0)), Origin(*ORIGIN), 50.0, 10.0)
    moving = (flight.t_s > HOVER_S + 6.0) & (flight.t_s < HOVER_S + 20.0)
    assert np.allclose(np.linalg.norm(flight.v_n[moving], axis=1), 10.0, atol=0.05)
    c, s = np.cos(flight.heading_rad), np.sin(flight.heading_rad)
    R_nb = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    a_n = flight.accel_b @ R_nb.T + [0.0, 0.0, GRAVITY]
    v_n = np.cumsum(a_n, axis=0) / RATE_HZ
    assert np.allclose(v_n, flight.v_n, atol=0.1)
    assert flight.heading_rad == pytest.approx(np.pi / 2, abs=1e-4)
    assert np.allclose(flight.p_n[-1], (200.0, 300.0, -50.0), atol=0.5)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.gpx", '<gpx xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>{}</trkseg></trk></gpx>'),
        ("a.geojson", '{{"type":"FeatureCollection","features":[{{"geometry":{{"type":"LineString","coordinates":[{}]}}}}]}}'),
        ("a.csv", "lat,lon\n{}"),
    ],
)
def test_routes_of_each_format(name: str, text: str, tmp_path: Path) -> None:
    form = {"gpx": '<trkpt lat="{}" lon="{}"/>', "csv": "{}, {}\n", "geojson": "[{1}, {0}, 5]"}[name.partition(".")[2]]
    points = ("," if "geojson" in name else "").join(form.format(lat, lon) for lat, lon in NORTH.tolist())
    (tmp_path / name).write_text(text.format(points))
    assert np.array_equal(read(tmp_path / name), NORTH)


def test_what_is_no_route_is_refused_in_one_line(tmp_path: Path) -> None:
    for text in ("", "<gpx>", '{"type": "Feature"}', "hello", "47.4, 8.5", "470, 8\n471, 8"):
        (tmp_path / "a").write_text(text)
        with pytest.raises(MapError, match="holds no route"):
            read(tmp_path / "a")
    with pytest.raises(MapError, match="takes"):
        fly(places((0.0, 0.0), (10.0, 0.0)), Origin(*ORIGIN), 50.0, 10.0)


def test_the_command_draws_and_prints_and_its_exit_code_is_the_verdict(tmp_path: Path) -> None:
    (tmp_path / "map.geojson").write_bytes(houses(lambda k: 9.0 + 1.6 * k).to_geojson())
    (tmp_path / "route.csv").write_text("\n".join(f"{lat}, {lon}" for lat, lon in NORTH[:2]))
    args = ["forecast", str(tmp_path / "route.csv"), "--map", str(tmp_path / "map.geojson"), "--speed", "16"]
    said = CliRunner().invoke(app, [*args, "-o", str(tmp_path / "f.png")])
    assert said.exit_code == 1
    assert "not fit" in said.stdout
    assert "no landmark in view" in said.stdout
    assert (tmp_path / "f.png").stat().st_size > 20_000
    (tmp_path / "short.csv").write_text("\n".join(f"{lat}, {lon}" for lat, lon in places((0.0, 0.0), (160.0, 0.0))))
    args[1] = str(tmp_path / "short.csv")
    loose = CliRunner().invoke(app, [*args, "--limit", "5000", "--json"])
    assert (loose.exit_code, json.loads(loose.stdout)["fit"]) == (0, True)
