"""Flights with GNSS: hide it for 10, 30 or 60 s, score against the hidden rows; and one real GNSS fault.

    e = p_gnss - p_hat,   NEES = e' (P + S_gnss)^-1 e / 3

A window begins after a minute of aiding (less on short flights), in motion, and is one sample.
"""

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.flights.tasks import INSIDE95, data_folder
from benchmarks.tables import Table, number
from estimator.config import Config, load
from estimator.fusion import Fusion
from logs.evaluation.metrics import Mask, Times, nees
from logs.evaluation.trajectory import nearest
from logs.importers import csv_folder
from logs.importers.recording import Recording, Truth
from models.frames import Origin
from models.messages import AidStatus, Array, Estimate, GnssFix, GnssVelocity, Input, Reading, Reason
from models.state import E, X

FLIGHTS = {
    "thor75": "umn_thor75",
    "quad106": "inertialnav_logs/quad106",
    "log171": "ardupilot_logs/log171",
    "drive_0708": "rtk_drive_walk/drive_0708",
    "flight_a": "quad_rtk_dot/flight_a",
}
GLITCH, GLITCH_S = "inertialnav_logs/f450_glitch", 116.0  # from here on its receiver is wrong
LENGTHS_S = (10.0, 30.0, 60.0)
AIDED_S = 60.0  # before a window, and between windows; at most 40 % of the flight
MINUTE_NS = 60_000_000_000
MOVING_M_S = 1.0
SIGMA_M = np.array([1.5, 1.5, 3.0])  # of a receiver that gives no covariance


class Outage(msgspec.Struct, frozen=True):
    """One window: errors at the hidden rows."""

    rmse_m: float
    end_m: float
    nees: float
    inside95: float


class Track(msgspec.Struct, frozen=True):
    """Estimates as arrays: t_ns (n,), p_n (n, 3), covariance of position (n, 3, 3), and where n's origin is."""

    t_ns: Times
    p_n: Array
    covariance: Array
    origin: Origin | None


def tables(out: Path, processes: int) -> list[Table]:
    """Both tables; a line on the terminal for each flight that is done."""
    with ProcessPoolExecutor(processes) as pool:
        glitch = pool.submit(glitch_table, out)
        futures = {name: pool.submit(outage_rows, name, out) for name in FLIGHTS}
        rows: list[tuple[str, ...]] = []
        for name, future in futures.items():
            rows += future.result()
            print(f"GNSS hidden: {name} done", flush=True)
        columns = ("flight", "hidden s", "windows", "RMSE m", "end m", "worst end m", "NEES/3", "in 95 %")
        outages = Table("GNSS hidden, scored at the hidden rows (medians over windows; NEES and share: means)", columns, rows)
        return [outages, glitch.result()]


def outage_rows(name: str, out: Path) -> list[tuple[str, ...]]:
    """A flight with windows of all lengths."""
    recording, config = flight(FLIGHTS[name], out)
    return [outage_row(name, recording, config, length_s) for length_s in LENGTHS_S]


def flight(folder: str, out: Path) -> tuple[Recording, Config]:
    """A flight as imported, and the configuration that the importer writes next to it."""
    source = data_folder() / "flights" / folder
    recording = csv_folder.read(source)
    path = out / f"{source.name}.toml"
    path.write_text(recording.settings.toml("csv", source, tuple(s.topic for s in recording.streams)))
    return recording, load(path)


def run(messages: Sequence[Input], config: Config) -> tuple[Track, list[AidStatus]]:
    """Everything through Fusion.handle; the first estimate of each stamp counts."""
    fusion = Fusion(config.fusion())
    estimates: dict[int, Estimate] = {}
    statuses: list[AidStatus] = []
    for message in messages:
        for output in fusion.handle(message):
            if isinstance(output, Estimate):
                estimates.setdefault(output.t_ns, output)
            elif isinstance(output, AidStatus):
                statuses.append(output)
    track = [estimates[t] for t in sorted(estimates)]
    return Track(
        np.array([e.t_ns for e in track], np.int64),
        np.array([e.nav[X.P] for e in track]).reshape(-1, 3),
        np.array([e.covariance[E.P, E.P] for e in track]).reshape(-1, 3, 3),
        Origin.of(track[-1].origin) if track else None,
    ), statuses


def inputs(recording: Recording) -> list[Input]:
    """What the estimator may see, in the order of arrival."""
    return [m for m in recording if not isinstance(m, Truth)]


def windows(recording: Recording, length_s: float) -> list[tuple[int, int]]:
    """Spans [ns] to hide: regularly spaced, the vehicle moving, aiding before and after."""
    fixes = [m for m in recording if isinstance(m, GnssFix) and m.status >= 0]
    speeds = [(m.t_ns, float(np.hypot(*m.v_n[:2]))) for m in recording if isinstance(m, GnssVelocity)]
    t = np.array([m.t_ns for m in fixes]) * 1e-9
    aided_s = min(AIDED_S, 0.4 * (t[-1] - t[0]))
    spans = []
    begin = t[0] + aided_s
    while begin + length_s + 5.0 < t[-1]:
        inside = [speed for t_ns, speed in speeds if begin < t_ns * 1e-9 < begin + length_s]
        if inside and np.median(inside) > MOVING_M_S:
            spans.append((round(begin * 1e9), round((begin + length_s) * 1e9)))
            begin += length_s + aided_s
        else:
            begin += 10.0
    return spans


def outage_row(name: str, recording: Recording, config: Config, length_s: float) -> tuple[str, ...]:
    """Hide, run, score: one line of the table."""
    spans = windows(recording, length_s)
    if not spans:
        return (name, f"{length_s:.0f}", "0", "-", "-", "-", "-", "-")

    def hidden(m: Input) -> bool:
        return isinstance(m, GnssFix | GnssVelocity) and any(a < m.t_ns < b for a, b in spans)

    messages = inputs(recording)
    rows = [m for m in messages if isinstance(m, GnssFix) and m.status >= 0 and hidden(m)]
    track, _ = run([m for m in messages if not hidden(m)], config)
    outages = [score(track, [m for m in rows if a < m.t_ns < b], recording.settings.gnss_delay_s) for a, b in spans]
    figures = np.array([(o.rmse_m, o.end_m, o.nees, o.inside95) for o in outages if o is not None]).reshape(-1, 4)
    if not len(figures):
        return (name, f"{length_s:.0f}", f"0 of {len(spans)}", "-", "-", "-", "-", "-")
    median, mean = np.median(figures, axis=0), figures.mean(axis=0)
    worst = figures[:, 1].max()
    cells = (number(float(x)) for x in (median[0], median[1], worst, mean[2], mean[3]))
    return (name, f"{length_s:.0f}", f"{len(figures)} of {len(spans)}", *cells)


def score(track: Track, rows: list[GnssFix], delay_s: float) -> Outage | None:
    """Errors of the estimate at the validity of the rows; None where there is no estimate."""
    t_ns = np.array([m.t_ns for m in rows], np.int64) - round(delay_s * 1e9)
    row, near = nearest(track.t_ns, t_ns, 50_000_000)
    if track.origin is None or not near.all():
        return None
    p_gnss = np.array([track.origin.to_ned(m.lat_deg, m.lon_deg, m.alt_m) for m in rows])
    error = p_gnss - track.p_n[row]
    sigma2 = np.array([np.diag(SIGMA_M**2) if m.covariance_n is None else m.covariance_n for m in rows])
    ratio = nees(error, track.covariance[row] + sigma2)
    size = np.linalg.norm(error, axis=1)
    rmse = float(np.sqrt(np.mean(size**2)))
    return Outage(rmse, float(size[-1]), float(ratio.mean() / 3.0), float(np.mean(ratio < INSIDE95)))


def glitch_table(out: Path) -> Table:
    """f450_glitch: the receiver's height walks off by 100 m and its velocity jumps, while the barometer stays.

    Height is judged against the barometer, levelled over the minute before the fault; an error is confident where it exceeds
    3 sigma of the estimate.
    """
    recording, config = flight(GLITCH, out)
    messages = inputs(recording)
    track, statuses = run(messages, config)
    start_ns = messages[0].t_ns
    fault_ns = start_ns + round(GLITCH_S * 1e9)
    last = {(s.topic, s.kind, s.t_ns): s for s in statuses if s.topic.startswith("/gnss")}  # its last revision
    before = [s for s in last.values() if fault_ns - MINUTE_NS <= s.t_ns < fault_ns]
    later = [s for s in last.values() if s.t_ns >= fault_ns]
    refused = [s.t_ns for s in later if s.reason is not Reason.FUSED]
    baro = [m for m in messages if isinstance(m, Reading) and m.kind == "baro"]
    t_ns = np.array([m.t_ns for m in baro], np.int64)
    height = 44330.8 * (1.0 - (np.array([m.values[0] for m in baro]) / 101325.0) ** 0.190263)  # standard atmosphere
    row, near = nearest(track.t_ns, t_ns, 50_000_000)
    t_s, row, height = (t_ns[near] - start_ns) * 1e-9, row[near], height[near]
    error = -track.p_n[row, 2] - height
    error -= np.median(error[(t_s > GLITCH_S - 60.0) & (t_s < GLITCH_S)])
    sigma = np.sqrt(track.covariance[row, 2, 2])
    after = t_s >= GLITCH_S
    confident = after & (np.abs(error) > 3.0 * sigma)
    rows: list[tuple[str, ...]] = [
        ("GNSS fused in the minute before the fault", _share_fused(before)),
        ("GNSS first refused, s after the fault begins", number((min(refused) - fault_ns) * 1e-9) if refused else "never"),
        ("GNSS fused after the fault begins", _share_fused(later)),
        ("worst height error, m (its sigma)", _worst(error, sigma, after)),
        ("worst confident height error, m (its sigma)", _worst(error, sigma, confident)),
    ]
    return Table("f450_glitch: a real GNSS fault from 116 s on, height against the barometer", ("figure", "value"), rows)


def _share_fused(statuses: Sequence[AidStatus]) -> str:
    return f"{sum(s.reason is Reason.FUSED for s in statuses)} of {len(statuses)}"


def _worst(error: Array, sigma: Array, where: Mask) -> str:
    if not where.any():
        return "none"
    k = int(np.argmax(np.where(where, np.abs(error), -1.0)))
    return f"{number(abs(error[k]))} ({number(sigma[k])})"
