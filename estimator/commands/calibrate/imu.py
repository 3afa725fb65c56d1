"""landfix calibrate imu, camera-imu."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from estimator.commands.calibrate import options
from estimator.commands.common.console import ConfigFile, Json, note, progress

if TYPE_CHECKING:
    from calib.inertial.camera_imu import CameraImu, Recording
    from calib.inertial.imu import SixPosition, Static
    from estimator.config import Config

_NOISE = ("density", "density_sigma", "white_from_s", "instability", "instability_sigma", "walk", "walk_sigma")
_MOST_IMAGES = 6000  # five minutes at 20 Hz
_LEAST_SOUND = 0.99  # of the IMU's samples must be finite; the few others are left out

Log = Annotated[Path, typer.Argument(metavar="LOG.mcap", help="Log of the IMU; other recordings: landfix import first.")]


def imu_command(
    log: Log,
    config: ConfigFile = None,
    six: Annotated[
        bool, typer.Option("--six", help="Also scale and bias of the accelerometer, from rests on all six sides.")
    ] = False,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Write the noise as a configuration, TOML.")] = None,
    report_file: options.ReportFile = None,
    json: Json = False,
) -> None:
    """Measure the noise of an IMU: Allan deviation of its longest rest.

    The results are those of a sensor at rest. In flight vibration adds to them: effective values are up to 20 times larger.

    \b
    Examples:
      landfix calibrate imu still.mcap -o imu.toml --report imu.html
      landfix calibrate imu sides.mcap --six --json       laid on each of its six sides for five seconds
    """
    from calib.inertial import imu, imu_report
    from calib.report import page as report

    page = report_file or log.with_suffix(".html")
    options.check_outputs(page, out, log)
    with progress("calibrate") as update:
        recording = _recording(log, _config(config), update)
        static = imu.static_noise(recording.t_ns, recording.gyro, recording.accel)
        sides = imu.six_position(recording.t_ns, recording.gyro, recording.accel) if six else None
    judged, tables = imu_report.of_static(static), imu_report.static_tables(static)
    if sides is not None:
        tables.append(imu_report.six_table(sides))
    written = report.write(page, f"IMU of {log.name}", judged, tables, imu_report.static_figure(static))
    if out is not None:
        options.write_text(out, _toml(static))
        written.append(out)
    options.tell(judged, tables, [], written, _imu_facts(static, sides) if json else None)


def camera_imu_command(
    log: Log,
    rig: Annotated[Path, typer.Option(help="The stereo rig (landfix calibrate stereo); its left camera is the one filming.")],
    out: options.OutFile,
    board: options.BoardSize = "9x6",
    square_mm: options.SquareMm = 25.0,
    marker_mm: options.MarkerMm = 0.0,
    dictionary: options.Dictionary = "DICT_5X5_1000",
    topic: Annotated[str, typer.Option(help="Topic of the left images.")] = "/left/image",
    config: ConfigFile = None,
    report_file: options.ReportFile = None,
    json: Json = False,
) -> None:
    """Calibrate the camera's pose on the IMU, and its time offset.

    Fix the board to the room. Move the vehicle briskly by hand for a minute: turn it about all three axes and shake it along all
    three, with the whole board in view. OUT is the rig with its pose on the body, covariance and time offset.

    \b
    Examples:
      landfix calibrate camera-imu moving.mcap --rig rig.yaml -o vehicle_rig.yaml -c vehicle.toml
    """
    import msgspec
    import numpy as np

    from calib.cameras.mono import Dropped
    from calib.files import formats
    from calib.inertial import camera_imu, imu_report
    from calib.report import page as report
    from estimator.commands.common.views import gather

    options.check_outputs(report_file or out, out, log)
    stereo, pattern, settings = formats.load_rig(rig), options.board_of(board, square_mm, marker_mm, dictionary), _config(config)
    with progress("calibrate") as update:
        recording = _recording(log, settings, lambda f: update(0.05 * f))
        views, unused = gather([str(log)], topic, pattern, lambda f: update(0.05 + 0.55 * f), _MOST_IMAGES)
        options.check_size(stereo.left, views[0][1])
        stamps = np.array([key for key, _ in views], dtype=np.int64)
        result = camera_imu.calibrate(
            recording, stamps, [v for _, v in views], pattern, stereo.left, settings.imu, lambda f: update(0.6 + 0.4 * f)
        )
    judged, tables = imu_report.of_camera_imu(result), imu_report.camera_imu_tables(result)
    placed = msgspec.structs.replace(
        stereo, R_bc=result.R_bc, p_bc=result.p_bc, covariance_bc=result.covariance[:6, :6], time_offset_s=result.time_offset_s
    )
    written = formats.save_rig(out, placed)
    written += report.write(report_file or out, f"Camera on IMU {out.name}", judged, tables, imu_report.camera_imu_figure(result))
    without = [Dropped(f"{len(unused)} images", "no whole board in view, or blurred")] if unused else []
    options.tell(judged, tables, without, written, _camera_imu_facts(result) if json else None)


def _config(path: Path | None) -> "Config":
    from estimator.config import Config, Imu, load

    if path is not None:
        return load(path)
    return Config(imu=Imu(gyro_noise=5e-4, accel_noise=5e-3, gyro_walk=3e-5, accel_walk=3e-3))


def _recording(log: Path, config: "Config", update: Callable[[float], None]) -> "Recording":
    import numpy as np

    from calib.errors import CalibrationError
    from calib.inertial.camera_imu import Recording
    from logs.store.reader import LogReader
    from models.messages import ImuSample

    decoder, samples = config.decoder(), list[ImuSample]()
    with LogReader(log) as reader:
        for k, record in enumerate(reader):
            message = decoder.decode(record.topic, record.schema, record.data, record.log_time_ns)
            if isinstance(message, ImuSample):
                samples.append(message)
            if k % 1000 == 0:
                update(reader.fraction)
    if not samples:
        raise CalibrationError(f"{log}: no IMU in it under the configuration's topic")
    samples.sort(key=lambda s: s.t_ns)
    t_ns = np.array([s.t_ns for s in samples], dtype=np.int64)
    gyro, accel = (np.array([getattr(s, name) for s in samples]) for name in ("gyro_b", "accel_b"))
    sound = np.isfinite(gyro).all(axis=1) & np.isfinite(accel).all(axis=1)
    if not sound.mean() > _LEAST_SOUND:
        raise CalibrationError(f"{log}: {int((~sound).sum())} of {len(sound)} IMU samples are not finite: mend what logs them")
    if not sound.all():
        note(f"{int((~sound).sum())} IMU samples are not finite and are left out")
    used = sound & np.concatenate(([True], np.diff(t_ns) > 0))
    return Recording(t_ns[used], gyro[used], accel[used])


def _toml(static: "Static") -> str:
    values = static.config()
    lines = [f"{key} = {value:.6g}\n" for key, value in values.items()]
    lines += [f"# {key}: not seen in {static.duration_s:.0f} s\n" for key in ("gyro_walk", "accel_walk") if key not in values]
    return "[imu]  # at rest; vibration in flight adds to it\n" + "".join(lines)


def _imu_facts(static: "Static", sides: "SixPosition | None") -> dict[str, Any]:
    facts: dict[str, Any] = {
        "rest_s": static.duration_s, "rate_hz": static.rate_hz, "longest_averaging_s": static.longest_tau_s,
        "config": static.config(),
    }  # fmt: skip
    for name in ("gyro", "accel"):
        facts[name] = [{key: getattr(n, key) for key in _NOISE} for n in getattr(static, name)]
    if sides is not None:
        sigma = [float(v) ** 0.5 for v in sides.covariance.diagonal()]
        facts["six_position"] = {
            "bias": sides.bias.tolist(),
            "scale": sides.scale.tolist(),
            "sigma": sigma,
            "residual": sides.residual,
        }
    return facts


def _camera_imu_facts(result: "CameraImu") -> dict[str, Any]:
    return {
        "R_bc": result.R_bc.tolist(), "p_bc_m": result.p_bc.tolist(), "time_offset_s": result.time_offset_s,
        "covariance": result.covariance.tolist(), "mean_square": result.mean_square, "residual_px": result.residual_px,
        "images": result.images,
    }  # fmt: skip
