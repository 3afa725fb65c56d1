"""Positions against each other, the receiver's velocity, the map's origin."""

from typing import Final

import numpy as np

from logs.findings.relation import Relation, relation
from logs.findings.streams import Cause, Stream
from models.frames import Origin
from models.messages import Array, Vec3

_FAR_M: Final = 1e6
_SUSPECT_M: Final = 5e3
_NOWHERE: Final = 0.02  # of all fixes, at 0, 0
_NEAR: Final = 0.1  # of that distance: where another reading of the numbers lies
_DRIVER: Final = "mend the driver of the receiver"
_STEP_S: Final = 1.0
_LONGEST_S: Final = 6.0
_LEAST_STEPS: Final = 8
_LEAST_M: Final = 1.0  # RMS of a step: a receiver's noise is less
_AWAY_STEPS: Final = 15
_AWAY_M_S, _AWAY_SHARE, _TOGETHER_M_S = 0.7, 0.05, 0.2
_ODOMETRY_M, _EXPLAINED, _LONGER = 0.5, 0.35, 1.15  # RMS of a step; share that is left; of the scale, beyond noise and heading
_NOISE_STEPS: Final = 6.0  # extent of positions that are noise of one place: 3 to 5 of their steps
_LATE_S: Final = [s for s in np.arange(-1.5, 1.55, 0.1) if abs(s) > 0.25]
_LATE_M, _LATE_GAIN = 0.3, 0.3  # RMS of a step at the stamps as they are; of its power, what other stamps leave
_ACCURACY_M: Final = (2e-3, 1e3)  # of any receiver that is of use
_HEIGHT_M: Final = (-1e3, 3e4)
_PRESSURE_RATIO: Final = 1.12  # weather and a map's geoid make 1.05
_JUMP_PA: Final = 200.0  # 17 m
_JUMP_S: Final = 0.5
_PRESSURE_PA: Final = (2e4, 1.15e5)
_SPEED_UNITS: Final = ((3.6, "km/h"), (1.94384, "knots"), (100.0, "cm/s"), (1000.0, "mm/s"), (2.23694, "mph"))
_LENGTH_UNITS: Final = ((100.0, "centimetres"), (1000.0, "millimetres"), (3.28084, "feet"), (1e-3, "kilometres"))


def far(stream: Stream, origin: Vec3 | None) -> Cause | None:
    """Fixes > 1,000 km from [map] origin, or at 0, 0."""
    lat, lon, alt = np.median(stream.values[:, :3], axis=0).tolist()
    since_s, nowhere = float(stream.arrived_s[0]), (stream.values[:, :2] == 0.0).all(axis=1)
    if (n := int(np.count_nonzero(nowhere))) > _NOWHERE * (count := len(stream.t_s)):
        what = f"{'its' if n == count else f'{n} of its {count}'} fixes are at latitude 0, longitude 0"
        since_s = float(stream.arrived_s[int(np.argmax(nowhere))])
        return Cause(what, since_s, "the receiver has no fix: let it report status -1")
    if abs(lat) > 90.0 or abs(lon) > 360.0:
        swapped = abs(lon) <= 90.0 and abs(lat) <= 180.0
        what = "latitude and longitude are exchanged" if swapped else f"latitude {lat:.6g}, longitude {lon:.6g} are no degrees"
        return Cause(what, since_s, _DRIVER)
    if alt < _HEIGHT_M[0] or alt > _HEIGHT_M[1]:  # NaN: not given
        return Cause(f"its height is {alt:.6g} m", since_s, "send metres above the ellipsoid")
    if origin is None or (away_m := _distance(origin, lat, lon)) < _SUSPECT_M:
        return None
    others = {
        "latitude and longitude are exchanged": (lon, lat),
        "the longitude has the wrong sign": (lat, -lon),
        "the latitude has the wrong sign": (-lat, lon),
        "both latitude and longitude have the wrong sign": (-lat, -lon),
        "latitude and longitude are in radians": (np.degrees(lat), np.degrees(lon)),
        "minutes are written as a fraction of a degree (ddmm.mmmm / 100)": (_of_minutes(lat), _of_minutes(lon)),
    }
    names = [name for name, (a, b) in others.items() if abs(a) <= 90.0 and _distance(origin, a, b) < _NEAR * away_m]
    if not names and away_m < _FAR_M:
        return None
    what = names[0] if names else f"its fixes are {1e-3 * away_m:.0f} km from [map] origin"
    advice = _DRIVER if names else f"set [map] origin = [{lat:.6f}, {lon:.6f}, {alt:.1f}], or mend the receiver"
    return Cause(what, since_s, advice)


def accuracy(stream: Stream) -> Cause | None:
    """A reported sigma that no receiver has, or none of use."""
    given = stream.values[stream.values[:, 3] > 0.0, 3]
    sigma = float(np.median(given)) if len(given) else 1.0
    if _ACCURACY_M[0] < sigma < _ACCURACY_M[1]:
        return None
    advice = "let its driver fill in the covariance in m^2, or leave it 0 where the accuracy is not known"
    return Cause(f"it reports an accuracy of {sigma:.2g} m, which no receiver has", float(stream.arrived_s[0]), advice)


def positions(stream: Stream) -> tuple[Array, Array]:
    """Stamps (n,) [s], positions (n, 3) [m]: NED about the first fix, or p_n."""
    ordered = stream.in_order()
    if stream.kind != "gnss":
        return ordered.t_s, ordered.values[:, :3]
    lla = ordered.values[:, :3]
    if not len(lla):
        return ordered.t_s, lla
    radius = np.radians(1.0) * 6_371_000.0
    east = radius * np.cos(np.radians(lla[0, 0]))
    return ordered.t_s, (lla - lla[0]) * [radius, east, -1.0]


def velocity_relation(fixes: Stream, velocity: Stream) -> Relation | None:
    """Way between fixes by the velocity's integral, horizontal; None: too little motion."""
    ordered = velocity.in_order()
    if len(ordered.t_s) < _LEAST_STEPS:
        return None
    return _related((ordered.t_s, _way(ordered)), positions(fixes), 2)


def still_or_forward(fixes: Stream, velocity: Stream, name: str) -> Cause | None:
    """A velocity of 0, or along one axis only, while positions move on all ways; name: of the fixes."""
    t, p = positions(fixes)
    steps = np.abs(np.diff(p[:, :2], axis=0))
    moved = float(np.linalg.norm(np.ptp(p[:, :2], axis=0))) if len(t) else 0.0
    since_s, v = float(velocity.arrived_s[0]), velocity.values
    if moved < 20.0 or not len(steps):
        return None
    if not v.any():
        return Cause(f"all its readings are 0 while {name} moves by {moved:.0f} m", since_s, "its driver gives no velocity")
    along, across = np.sqrt(np.mean(v[:, :2] ** 2, axis=0))
    if across < 0.1 * along and steps[:, 1].sum() > 0.3 * steps[:, 0].sum():
        what = f"it is along one axis while {name} moves north and east: it is in the body's axes"
        return Cause(what, since_s, "send east, north, up of the world")
    return None


def runs_away(fixes: Stream, velocity: Stream, name: str) -> Cause | None:
    """d(p - int v dt) / dt over 15 s rises from below 0.2 m/s to above 0.7 m/s and 5 % of the speed; name: of the velocity."""
    t, p = positions(fixes)
    v = velocity.in_order()
    if len(t) < _LEAST_STEPS or len(v.t_s) < _LEAST_STEPS or np.diff(v.t_s).max() > _LONGEST_S or np.diff(t).max() > _LONGEST_S:
        return None
    way = _way(v)
    at = np.arange(max(t[0], v.t_s[0]), min(t[-1], v.t_s[-1]), _STEP_S)
    apart = np.stack([np.interp(at, t, p[:, k]) - np.interp(at, v.t_s, way[:, k]) for k in range(2)], axis=1)
    speed = np.linalg.norm(apart[_AWAY_STEPS:] - apart[:-_AWAY_STEPS], axis=1) / (_AWAY_STEPS * _STEP_S)
    most_m_s = _AWAY_M_S + _AWAY_SHARE * float(np.quantile(np.linalg.norm(v.values[:, :2], axis=1), 0.95))
    if len(speed) < _AWAY_STEPS or speed.max() < most_m_s or np.median(speed[: _AWAY_STEPS // 3]) > _TOGETHER_M_S:
        return None
    k = int(np.argmax(speed > _TOGETHER_M_S))
    if np.mean(speed[k:] > _TOGETHER_M_S) < 0.9:
        return None
    what = f"its positions run away from {name} at up to {speed.max():.1f} m/s"
    return Cause(what, fixes.arrival_at(float(at[k])), "a receiver that is spoofed slowly, or a velocity that is not its own")


def late(fixes: Stream, velocity: Stream) -> float | None:
    """By how many seconds the fixes' stamps must be earlier to fit the velocity's integral; None: they fit, or none does."""
    v = velocity.in_order()
    if len(v.t_s) < _LEAST_STEPS:
        return None
    way, (t, p) = _way(v), positions(fixes)
    left = {s: float(np.mean(np.sum((b - a) ** 2, axis=1))) for s in (0.0, *_LATE_S)
            if (steps := _steps((v.t_s, way), (t - s, p), 2)) is not None for a, b in [steps]}  # fmt: skip
    if left.get(0.0, 0.0) ** 0.5 < _LATE_M:
        return None
    best = min(left, key=lambda s: left[s])
    return best if left[best] < _LATE_GAIN * left[0.0] else None


def position_relation(fixes: Stream, others: Stream) -> Relation | None:
    """Way of the other source by that between fixes, horizontal."""
    return _related(positions(fixes), positions(others), 2)


def stretched(odometry: Stream, known: Stream, name: str) -> Cause | None:
    """Ways of an odometry of another length than those between known positions; name: of these."""
    at = positions(known)
    steps = _steps(positions(odometry), at, 2)
    if steps is None or len(steps[0]) < _AWAY_STEPS or (step_m := np.mean(np.sum(steps[1] ** 2, axis=1)) ** 0.5) < _ODOMETRY_M:
        return None
    since_s = float(odometry.arrived_s[0])
    if not steps[0].any():
        if np.linalg.norm(np.ptp(at[1][:, :2], axis=0)) < _NOISE_STEPS * step_m:
            return None
        return Cause(
            f"its position never changes while {name} moves", since_s, "it has not begun, or is lost: let it be silent then"
        )
    found = relation(*steps)
    if found.rest > _EXPLAINED or not found.scale > 0.0 or abs(np.log(found.scale)) < np.log(_LONGER):
        return None
    what = f"its ways are {1.0 / found.scale:.2f} times as long as those of {name}"
    advice = "mend its scale (baseline, wheel radius), or let [odometry] scale_sigma be as large"
    return Cause(what, since_s, advice)


def of_velocity(found: Relation) -> str:
    """Error between position (b) and velocity (a)."""
    if found.mirrored:
        (nn, ne), (_, ee) = found.O
        if abs(ne) > 0.8:
            return "north and east are exchanged"
        return "east has the wrong sign" if nn > 0.8 and ee < -0.8 else "north has the wrong sign" if nn < -0.8 else "mirrored"
    if found.angle_deg > 10.0:
        return "its signs are reversed" if found.angle_deg > 165.0 else f"turned by {found.angle_deg:.0f} degrees"
    return _unit(1.0 / found.scale, _SPEED_UNITS)


def of_position(found: Relation) -> str:
    """Error of a position (b) against fixes (a)."""
    named = of_velocity(found)
    return of_scale(found.scale) if not found.mirrored and found.angle_deg <= 10.0 else named


def of_scale(scale: float, rest: float = 0.0) -> str:
    """Error of a length's unit; rest: of the relation."""
    return _unit(scale, _LENGTH_UNITS, rest)


def pressure(stream: Stream, alt_m: float | None) -> Cause | None:
    """A barometer's median is not air pressure in Pa; alt_m: where it is, if known."""
    usual, since_s = float(np.median(stream.values)), float(stream.arrived_s[0])
    low, high = _PRESSURE_PA if alt_m is None else (at_height(alt_m) / _PRESSURE_RATIO, at_height(alt_m) * _PRESSURE_RATIO)
    if _PRESSURE_PA[0] < usual < _PRESSURE_PA[1]:
        return None
    unit = next((f": it is in {name}" for factor, name in ((100.0, "hPa"), (1e3, "kPa"), (3386.4, "inHg"), (0.1, "0.1 Pa"))
                 if max(5e4, low) < factor * usual < min(high, _PRESSURE_PA[1])), "")  # fmt: skip
    other = ": that is no pressure of the air" + (", but may be a height" if -500.0 < usual < 9e3 else "")
    return Cause(f"it reads {usual:.6g} Pa{unit or other}", since_s, "send pascal")


def pressure_jump(stream: Stream) -> Cause | None:
    """A step of pressure that no climb makes, and that stays."""
    p = stream.values[:, 0]
    steps = np.abs(np.diff(p)) * (np.diff(stream.arrived_s) < _JUMP_S)
    k = int(np.argmax(steps)) + 1
    if steps[k - 1] < _JUMP_PA or not 10 <= k <= len(p) - 10:
        return None
    size = float(np.median(p[k : k + 10]) - np.median(p[k - 10 : k]))
    if abs(size) < 0.8 * _JUMP_PA:
        return None
    what = f"its pressure jumps by {size:+.0f} Pa ({-size / 12.0:+.0f} m) and stays"
    return Cause(what, float(stream.arrived_s[k]), "see its hose and port, or its driver")


def at_height(alt_m: float) -> float:
    """p = 101325 Pa (1 - h / 44330 m)^5.255, the standard atmosphere."""
    return float(101_325.0 * max(1.0 - alt_m / 44_330.0, 0.05) ** 5.255)


def _unit(factor: float, units: tuple[tuple[float, str], ...], rest: float = 0.0) -> str:
    near = [
        (abs(np.log(max(factor, 1e-12) / size)), name)
        for size, name in units
        if 0.92 * factor < size < 1.08 * factor / max(1.0 - rest, 0.3)
    ]  # noise of the other side makes it smaller
    name = min(near, default=(0.0, ""))[1]
    size = f"{factor:.3g} times too large" if factor > 1.0 else f"{1.0 / max(factor, 1e-12):.3g} times too small"
    return size + (f": {name}" if name else "")


def _way(velocity: Stream) -> Array:
    """int v dt (n, 3) from its first reading."""
    mean = 0.5 * (velocity.values[1:] + velocity.values[:-1])
    return np.concatenate([np.zeros((1, 3)), np.cumsum(mean * np.diff(velocity.t_s)[:, None], axis=0)])


def _of_minutes(deg: float) -> float:
    """dd + mm.mmmm / 60 of dd + mm.mmmm / 100."""
    return float(np.trunc(deg) + (deg - np.trunc(deg)) / 0.6)


def _related(a: tuple[Array, Array], b: tuple[Array, Array], axes: int) -> Relation | None:
    steps = _steps(a, b, axes)
    if steps is None or min(np.mean(np.sum(d**2, axis=1)) for d in steps) ** 0.5 < _LEAST_M:
        return None
    return relation(*steps)


def _steps(a: tuple[Array, Array], b: tuple[Array, Array], axes: int) -> tuple[Array, Array] | None:
    """Ways of a and b (n, axes) [m] between the stamps of b, 1 s apart or more; None: too few."""
    (t_a, p_a), (t_b, p_b) = a, b
    if len(t_a) < 2 or len(t_b) < 2:
        return None
    _, rows = np.unique(np.floor((t_b - t_b[0]) / _STEP_S), return_index=True)
    t, q = t_b[rows], p_b[rows]
    at = np.stack([np.interp(t, t_a, p, np.nan, np.nan) for p in p_a.T], axis=1)
    hole = np.interp(t, t_a[1:], np.diff(t_a)) > _LONGEST_S
    at[hole] = np.nan
    da, db = np.diff(at, axis=0)[:, :axes], np.diff(q, axis=0)[:, :axes]
    sound = (np.diff(t) < _LONGEST_S) & np.isfinite(da).all(axis=1)
    return (da[sound], db[sound]) if np.count_nonzero(sound) >= _LEAST_STEPS else None


def _distance(origin: Vec3, lat: float, lon: float) -> float:
    return float(np.linalg.norm(Origin(*origin).to_ned(float(lat), float(lon), origin[2])))
