"""The pictures of docs/estimator.md, from recorded flights: `python -m benchmarks.flights.estimator_pictures`.

EuRoC MH_04 with outages (scenario A) and V1_01 with consistent false fixes (scenario C), seed 0, through `landfix replay` and the
smoother. Prints the figures that the text quotes. Tasks and logs go to out/estimator_pictures.
"""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from benchmarks.flights.tasks import ROOT, Task, make, score, tool
from estimator.config import load
from estimator.replay.replay import replay
from estimator.replay.smooth_log import TOPIC, write_smoothed
from logs.evaluation.trajectory import Trajectory, decode, nearest
from logs.store.reader import LogReader
from logs.wire.codec import decode_aid_status
from models.messages import Array, Reason

IMAGES = ROOT / "docs" / "images"
WORK = ROOT / "out" / "estimator_pictures"
BLACK, BLUE, GREEN, VERMILLION, BAND, SHADE = "#000000", "#0072B2", "#009E73", "#D55E00", "#CDE7F7", "#EFEFEF"
SIGMAS_95 = 1.959964  # of one axis
AXES = ("east", "north", "up")
ODOMETRY, POSE_FIX = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseWithCovarianceStamped"


class Flight:
    """A task, replayed and smoothed: truth, estimate, smoothed estimate and fixes, in map (ENU)."""

    def __init__(self, flight: str, scenario: str) -> None:
        task = make(Task("euroc", flight, scenario, seed=0), WORK)
        assert task is not None
        estimate, smoothed = WORK / f"{task.stem}-estimate.mcap", WORK / f"{task.stem}-smoothed.mcap"
        config = load(task.with_suffix(".toml"))
        replay(task, estimate, config)
        write_smoothed(estimate, smoothed, config)
        self.score = score(task, estimate)
        rows: dict[str, list[tuple[bytes, int]]] = {}
        with LogReader(smoothed) as reader:
            for record in reader:
                rows.setdefault(record.topic, []).append((record.data, record.log_time_ns))
        self.truth, self.estimate, self.smoothed = (_odometry(rows[t]) for t in ("/truth", "/landfix/odometry", TOPIC))
        self.fixes = decode(POSE_FIX, *zip(*rows["/pose_fix"], strict=True))
        status = [decode_aid_status(data) for data, _ in rows["/landfix/aid_status"]]
        at_once = {s.t_ns: s.reason for s in reversed(status)}
        self.fused = np.array([at_once.get(t) in (Reason.FUSED, Reason.ALIGNING) for t in self.fixes.t_ns.tolist()])

        row, _ = nearest(self.truth.t_ns, self.fixes.t_ns, 3_000_000)
        self.false = np.linalg.norm(self.fixes.p - self.truth.p[row], axis=1) > 2.0

    def error(self, of: Trajectory) -> tuple[Array, Array, Array]:
        """Seconds, true minus estimated position (n, 3) and its standard deviation (n, 3), at the truth's stamps."""
        row, near = nearest(of.t_ns, self.truth.t_ns, 3_000_000)
        sigma = np.sqrt(np.diagonal(of.covariance, axis1=1, axis2=2)[:, :3])[row[near]]
        return seconds(self.truth.t_ns[near]), self.truth.p[near] - of.p[row[near]], sigma


def _odometry(rows: list[tuple[bytes, int]]) -> Trajectory:
    data, arrived = zip(*rows, strict=True)
    return decode(ODOMETRY, data, arrived)


def seconds(t_ns: Any) -> Array:
    return np.asarray((t_ns - tool().EPOCH_NS) * 1e-9)


def shade(axes: Axes, outages: list[tuple[float, float]]) -> None:
    for k, (begin, end) in enumerate(outages):
        axes.axvspan(begin, end, color=SHADE, zorder=0, label=None if k else "no fixes")
        for at in (begin, end):
            axes.axvline(at, color="0.5", lw=0.8, ls=":")


def draw_band(flight: Flight) -> Figure:
    """Errors of the three axes in their 95 % band, the smoothed ones over them."""
    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    t, error, sigma = flight.error(flight.estimate)
    ts, smoothed, _ = flight.error(flight.smoothed)
    grid = figure.subplots(3, 1, sharex=True)
    for k, axes in enumerate(grid):
        shade(axes, flight.score["outages"])
        band = SIGMAS_95 * sigma[:, k]
        axes.fill_between(t, -band, band, color=BAND, lw=0, label="95 % band of the filter")
        axes.plot(t, error[:, k], color=BLUE, lw=1.0, label="truth - filter")
        axes.plot(ts, smoothed[:, k], color=GREEN, lw=1.0, label="truth - smoother")
        axes.set_ylabel(f"{AXES[k]} error [m]")
        axes.set_yscale("symlog", linthresh=1.0, linscale=2.0)
        axes.set_yticks([-10.0, -1.0, -0.5, 0.0, 0.5, 1.0, 10.0], ["-10", "-1", "-0.5", "0", "0.5", "1", "10"])
        axes.yaxis.set_minor_locator(NullLocator())
        axes.grid(color="0.9", lw=0.5)
    grid[-1].set_xlim(5.0, t[-1])
    grid[-1].set_xlabel("time [s]")
    figure.legend(*grid[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    return figure


def draw_false_fixes(flight: Flight, begin: float, end: float) -> Figure:
    """One stretch: where the vehicle was, what the fixes said, what was published and when it came back; then the smoother."""
    figure = Figure(figsize=(9.0, 7.5), layout="constrained")
    e, s = flight.estimate, flight.smoothed
    t, ts, tf = seconds(e.t_ns), seconds(s.t_ns), seconds(flight.fixes.t_ns)
    seen = (tf >= begin) & (tf <= end)
    grid = figure.subplots(3, 1, sharex=True)
    for k, axes in enumerate(grid):
        shade(axes, flight.score["outages"])
        band = SIGMAS_95 * np.sqrt(e.covariance[:, k, k])
        axes.fill_between(t, e.p[:, k] - band, e.p[:, k] + band, color=BAND, lw=0, label="95 % band of the filter")
        axes.plot(t, e.p[:, k], color=BLUE, lw=1.2, label="filter")
        axes.plot(seconds(flight.truth.t_ns), flight.truth.p[:, k], color=BLACK, lw=1.2, label="truth")
        axes.plot(ts, s.p[:, k], color=GREEN, lw=1.2, ls="--", label="smoother")
        for marker, colour, which, name in (
            ("o", BLACK, seen & ~flight.false, "true fix"),
            ("X", VERMILLION, seen & flight.false, "false fix"),
        ):
            axes.plot(tf[which], flight.fixes.p[which, k], marker, color=colour, ms=6 if marker == "X" else 3, label=name)
        shown = (t >= begin) & (t <= end)
        values = np.concatenate([flight.fixes.p[seen, k], e.p[shown, k], flight.truth.p[:, k]])
        margin = 0.15 * np.ptp(values)
        axes.set_ylim(values.min() - margin, values.max() + margin)
        axes.set_ylabel(f"{AXES[k]} [m]")
        axes.grid(color="0.9", lw=0.5)
    grid[-1].set_xlim(begin, end)
    grid[-1].set_xlabel("time [s]")
    figure.legend(*grid[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    return figure


def rms(error: Array) -> float:
    return float(np.sqrt((error**2).sum(axis=1).mean()))


def tell(name: str, flight: Flight) -> None:
    """The figures that the text quotes."""
    r = flight.score
    print(
        f"{name}: outside outages {r['pos_m']:.2f} m, NEES/3 {r['nees_p']:.2f}, {100 * r['inside95']:.1f} % in the 95 % ellipsoid"
    )
    print(f"  false fixes: {flight.false.sum()}, of these fused at once {(flight.false & flight.fused).sum()}")
    t, error, _ = flight.error(flight.estimate)
    ts, smoothed, sigma = flight.error(flight.smoothed)
    size = np.linalg.norm(error, axis=1)
    for begin, end in r["outages"]:
        inside, also, after = (t > begin) & (t < end), (ts > begin) & (ts < end), (t >= end) & (t < end + 5.0)
        print(f"  outage {begin:.0f}-{end:.0f} s: RMSE filter {rms(error[inside]):.2f} m, smoother {rms(smoothed[also]):.2f} m")
        last = t[after & (size > 1.0)].max(initial=end) - end
        print(f"    in the 5 s after it: error at most {size[after].max():.2f} m, above 1 m until {last:.1f} s after it")
    kept = ts > 10.0
    covered = 100.0 * np.mean(np.abs(smoothed[kept]) < SIGMAS_95 * sigma[kept])
    print(f"  smoother from 10 s on: RMSE {rms(smoothed[kept]):.2f} m, {covered:.1f} % of its axis errors in their 95 % band")


def save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=90)
    print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


def main() -> None:
    WORK.mkdir(parents=True, exist_ok=True)
    outages = Flight("MH_04_difficult", "A")
    tell("MH_04 A", outages)
    save(draw_band(outages), IMAGES / "estimator_band.png")
    false = Flight("V1_01_easy", "C")
    tell("V1_01 A", Flight("V1_01_easy", "A"))
    tell("V1_01 C", false)
    save(draw_false_fixes(false, 22.0, 82.0), IMAGES / "estimator_lies.png")


if __name__ == "__main__":
    main()
