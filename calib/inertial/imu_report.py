"""Verdicts, tables, images of calibrations with an IMU."""

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib.inertial.allan import Noise
from calib.inertial.camera_imu import CameraImu
from calib.inertial.imu import SixPosition, Static
from calib.report.page import Table
from calib.report.plots import BLUE, GREEN, GREY, VERMILLION
from calib.report.verdict import Figure as Fact
from calib.report.verdict import Verdict
from models import so3

_COLOURS = (VERMILLION, GREEN, BLUE)  # x y z
_LONGER: Final = "let the IMU lie still for longer: ten minutes for the noise, hours for the random walk"
_HUM: Final = "motors off, and nothing that hums near: the noise is not white"
_MOVE: Final = "move more: turn briskly about all three axes and shake along all three, a minute, the whole board in view"
_MODEL: Final = (
    "innovations are larger than the configured noise: is --square-mm right, the board fixed, are [imu] axes and noise right, "
    "do its stamps jump?"
)
_FEW: Final = "record for a minute, the whole board in the image, in good light, so that more images count"


def of_static(result: Static) -> Verdict:
    """The verdict on noise figures."""
    spread = max(n.density_sigma / max(n.density, 1e-30) for n in (*result.gyro, *result.accel))
    return Verdict((
        Fact("seconds at rest short of 600", max(600.0 - result.duration_s, 0.0), "s", 0.0, 590.0, _LONGER),
        Fact("sigma of the noise density", 100.0 * spread, "%", 3.0, 15.0, _LONGER),
        Fact("averaging time from which the noise is white", result.white_from_s, "s", 0.2, 1.0, _HUM),
    ))  # fmt: skip


def of_camera_imu(result: CameraImu) -> Verdict:
    """The verdict on a camera's place on the IMU."""
    sigma = np.sqrt(np.diagonal(result.covariance))
    return Verdict((
        Fact("mean square of the innovations", result.mean_square, "", 1.5, 9.0, _MODEL),
        Fact("sigma of the translation", 1e3 * float(sigma[:3].max()), "mm", 3.0, 10.0, _MOVE),
        Fact("sigma of the rotation", float(np.rad2deg(sigma[3:6].max())), "deg", 0.05, 0.2, _MOVE),
        Fact("sigma of the time offset", 1e3 * float(sigma[6]), "ms", 0.3, 1.0, _MOVE),
        Fact("images short of 400", max(400.0 - result.images, 0.0), "", 0.0, 300.0, _FEW),
    ))  # fmt: skip


def static_tables(result: Static) -> list[Table]:
    """Noise of each axis, and configuration values."""
    rows = [
        (
            f"{name} {axis}", f"{n.density:.3g} +- {_percent(n.density_sigma / n.density)}", _seconds(n.white_from_s),
            _or_less(n.instability, n.instability_sigma), _or_less(n.walk, n.walk_sigma),
        )
        for name, noises in (("gyro", result.gyro), ("accel", result.accel))
        for axis, n in zip("xyz", noises, strict=True)
    ]  # fmt: skip
    seen = [
        ("at rest", f"{result.duration_s:.1f} s at {result.rate_hz:.0f} Hz"),
        ("noise known up to", f"{result.longest_tau_s:.2g} s of averaging; what is slower was not seen"),
    ]
    config = [(key, f"{value:.3g}") for key, value in result.config().items()] + [("in flight", "up to 20 times more: vibration")]
    header = ("rad/s, m/s^2", "density [1/sqrt(Hz)]", "white from [s]", "instability", "walk [1/s/sqrt(Hz)]")
    return [
        ("Rest", (), seen), ("Noise", header, rows),
        ("Configuration, section imu", (), config),
    ]  # fmt: skip


def _or_less(value: float, sigma: float) -> str:
    if not np.isfinite(sigma):
        return "not seen"
    return f"{value:.2g} +- {_percent(sigma / value)}" if value > 2.0 * sigma else f"< {value + 2.0 * sigma:.2g}"


def _percent(part: float) -> str:
    return f"{100.0 * part:.0f} %" if part >= 0.01 else f"{100.0 * part:.1f} %"


def _seconds(t: float) -> str:
    return "never" if np.isnan(t) else f"{t:.2g}"


def six_table(result: SixPosition) -> Table:
    """Scale and bias of the accelerometer."""
    sigma = np.sqrt(np.diagonal(result.covariance))
    rows = [
        (f"axis {a}", f"{b:.4f} +- {sb:.1g}", f"{s:.5f} +- {ss:.1g}")
        for a, b, s, sb, ss in zip("xyz", result.bias, result.scale, sigma[:3], sigma[3:], strict=True)
    ]
    title = (
        f"Accelerometer, {len(result.positions)} positions, residual {result.residual:.4f} m/s^2: true = (read - bias) / scale"
    )
    return title, ("", "bias [m/s^2]", "scale"), rows


def camera_imu_tables(result: CameraImu) -> list[Table]:
    """Extrinsics with their standard deviations."""
    sigma = np.sqrt(np.diagonal(result.covariance))
    roll, pitch, yaw = np.rad2deg(so3.to_euler(so3.from_matrix(np.ascontiguousarray(result.R_bc))))
    rows = [(f"p_bc {n}", f"{1e3 * x:.2f}", f"{1e3 * s:.2g}", "mm") for n, x, s in zip("xyz", result.p_bc, sigma, strict=False)]
    rows += [
        (f"rotation about {n} of the body", "", f"{np.rad2deg(s):.2g}", "deg") for n, s in zip("xyz", sigma[3:6], strict=True)
    ]
    rows += [("time offset (shutter minus stamp)", f"{1e3 * result.time_offset_s:.3f}", f"{1e3 * sigma[6]:.2g}", "ms")]
    matrix = [("R_bc", " ".join(f"{x:+.6f}" for x in row)) for row in result.R_bc]
    facts = [
        ("R_bc as roll, pitch, yaw", f"{roll:.3f}, {pitch:.3f}, {yaw:.3f} deg"),
        ("images used, left out", f"{result.images}, {result.dropped}"),
        ("residual of the corners", f"{result.residual_px:.3f} px"),
        ("first guess of the rotation, from rates alone, was off by", f"{result.rotation_only_deg:.3f} deg"),
        ("mean square of the normalised innovations (1 is right)", f"{result.mean_square:.2f}"),
    ]
    return [
        ("Camera on the body: x_b = R_bc x_c + p_bc", ("", "value", "+- sigma", "unit"), rows),
        ("Result", (), [*facts, *matrix]),
    ]


def static_figure(result: Static) -> Figure:
    """Allan deviation of the six axes with the fitted curves."""
    figure = Figure(figsize=(12.0, 5.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw_allan(left, result.gyro, "gyroscope", "rad/s")
    _draw_allan(right, result.accel, "accelerometer", "m/s^2")
    return figure


def camera_imu_figure(result: CameraImu) -> Figure:
    """Normalised innovations over time, and their distribution."""
    figure = Figure(figsize=(12.0, 7.0), layout="constrained")
    axes = figure.subplots(2, 2, width_ratios=(3, 1))
    for row, (part, what) in enumerate(((slice(0, 3), "position of the board"), (slice(3, 6), "rotation of the board"))):
        for k, name in enumerate("xyz"):
            axes[row, 0].plot(result.t_s, result.innovations[:, part][:, k], ".", markersize=2.5, color=_COLOURS[k], label=name)
        for limit in (-2.0, 2.0):
            axes[row, 0].axhline(limit, color=GREY, linewidth=0.8, linestyle="--")
        axes[row, 0].set_ylabel("normalised innovation")
        axes[row, 0].set_title(f"{what}: 95 % lie within the dashed lines if all is right", fontsize=10)
        axes[row, 0].legend(fontsize=8, loc="upper right")
        values = result.innovations[:, part].ravel()
        z = np.linspace(-4.5, 4.5, 181)
        axes[row, 1].hist(np.clip(values, -4.5, 4.5), bins=24, density=True, color=BLUE, alpha=0.6, label="innovations")
        axes[row, 1].plot(z, np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi), color=VERMILLION, label="normal")
        axes[row, 1].legend(fontsize=8)
        axes[row, 1].set_title(f"RMS {np.sqrt(np.mean(values**2)):.2f} (1 is right)", fontsize=10)
    axes[1, 0].set_xlabel("time [s]")
    return figure


def _draw_allan(axes: Axes, noises: tuple[Noise, Noise, Noise], what: str, unit: str) -> None:
    for name, n, colour in zip("xyz", noises, _COLOURS, strict=True):
        axes.errorbar(
            n.tau_s,
            n.adev,
            n.adev_sigma,
            fmt="o",
            markersize=3.5,
            color=colour,
            linewidth=0.8,
            label=f"{name}: N = {n.density:.3g}",
        )
        fitted = n.tau_s[n.tau_s >= n.white_from_s]
        axes.plot(fitted, n.model(fitted), color=colour, linewidth=0.9)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("averaging time [s]")
    axes.set_ylabel(f"Allan deviation [{unit}]")
    axes.set_title(f"{what}: measured (dots), fitted (lines); N [{unit}/sqrt(Hz)]", fontsize=10)
    axes.grid(alpha=0.25, which="both")
    axes.legend(fontsize=8)
