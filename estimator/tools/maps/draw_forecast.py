"""The forecast drawn: the radius along the route."""

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from estimator.tools.maps.forecast import Forecast
from models.frames import Origin
from models.maps.landmarks import LandmarkMap

_LANDMARK, _COLOURS = "#b5b0a4", "viridis_r"
_STATES = {
    "fix": ("#009E73", "landmarks give fixes"), "alike": ("#D55E00", "look-alikes"), "none": ("#888888", "no landmark in view"),
}  # fmt: skip


def draw(forecast: Forecast, the_map: LandmarkMap, title: str) -> Figure:
    """One picture of two plots."""
    origin = Origin(*the_map.origin)
    rows = forecast.rows
    north, east = np.array([origin.to_ned(row.lat_deg, row.lon_deg, origin.alt_m)[:2] for row in rows]).T
    radius, way = (np.array([getattr(row, name) for row in rows]) for name in ("radius95_m", "way_m"))
    figure = Figure(figsize=(9.0, 10.0), layout="constrained", dpi=120)
    above, below = figure.subplots(2, 1, height_ratios=(2.2, 1.0))
    c = the_map.columns
    margin = max(50.0, 0.1 * max(np.ptp(north), np.ptp(east)))
    near = (c.vertices[:, 0] > north.min() - margin) & (c.vertices[:, 0] < north.max() + margin)
    near &= (c.vertices[:, 1] > east.min() - margin) & (c.vertices[:, 1] < east.max() + margin)
    for a, b in zip(c.offsets[:-1].tolist(), c.offsets[1:].tolist(), strict=True):
        if near[a]:
            above.fill(c.vertices[a:b, 1], c.vertices[a:b, 0], color=_LANDMARK)
    points = np.column_stack((east, north))
    norm = LogNorm(max(0.1, radius.min()), max(1.0, radius.max()))
    segments = np.stack((points[:-1], points[1:]), axis=1).tolist()
    line = LineCollection(segments, cmap=_COLOURS, norm=norm, linewidths=4.0)
    line.set_array(radius[1:])
    above.add_collection(line)
    above.plot(east[0], north[0], "o", color="black", markersize=7, label="start, GPS ends")
    above.set(aspect="equal", xlabel="east [m]", ylabel="north [m]")
    above.set_xlim(east.min() - margin, east.max() + margin)
    above.set_ylim(north.min() - margin, north.max() + margin)
    above.legend(loc="upper right", fontsize=8)
    verdict = "fit" if forecast.fit else "not fit"
    above.set_title(f"{title}: {verdict}, worst 95 % radius {forecast.worst_radius95_m:.1f} m", fontsize=10, loc="left")
    figure.colorbar(line, ax=above, label="predicted 95 % radius [m]", shrink=0.8)
    below.semilogy(way, radius, color="black", linewidth=1.0)
    below.axhline(forecast.limit_m, color="#D55E00", linestyle="--", label=f"limit {forecast.limit_m:g} m")
    low = below.get_ylim()[0]
    for state, (colour, words) in _STATES.items():
        inside = np.array([row.state == state for row in rows])
        if inside.any():
            below.scatter(way[inside], np.full(inside.sum(), low), s=14, marker="s", color=colour, label=words, clip_on=False)
    below.set(xlabel="way [m]", ylabel="95 % radius [m]", xlim=(0.0, way.max()))
    below.set_ylim(bottom=low)
    below.grid(alpha=0.3)
    below.legend(fontsize=8, ncols=2)
    return figure
