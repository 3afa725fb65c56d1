"""landfix calibrate mono, stereo, dlt, convert."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from estimator.commands.calibrate import options
from estimator.commands.common.console import Json, print_json, print_table, progress
from estimator.commands.common.mount import Mount, MountSigma, mount_of

if TYPE_CHECKING:
    from calib.cameras.stereo import Stereo
    from calib.files.formats import BodyPose
    from models.camera import StereoRig
    from models.messages import Array


def mono_command(
    sources: Annotated[
        list[str], typer.Argument(metavar="IMAGES...", help="Images, folders, patterns, a video, a log, or camera:0.")
    ],
    out: options.OutFile,
    board: options.BoardSize = "9x6",
    square_mm: options.SquareMm = 25.0,
    marker_mm: options.MarkerMm = 0.0,
    dictionary: options.Dictionary = "DICT_5X5_1000",
    lens: options.LensOption = options.LensChoice.FIVE,
    mount: Mount = "",
    mount_sigma: MountSigma = "0.02,1",
    topic: Annotated[str, typer.Option(help="In a log: the images' topic.")] = "/left/image",
    report_file: options.ReportFile = None,
    json: Json = False,
) -> None:
    """Calibrate one camera.

    Needs about 20 images of a board, moved through the whole image and tilted each way. Those that differ most are used.
    With --mount (0,0,0,0,-90,0 looks down with the image's upper edge forward) the file is a rig of one camera.

    \b
    Examples:
      landfix calibrate mono images/ --board 9x6 --square-mm 25 -o camera.yaml
      landfix calibrate mono walk.mp4 --square-mm 40 --marker-mm 30 -o camera.yaml
      landfix calibrate mono images/ -o camera.yaml --mount 0.1,0,0.05,0,-90,0 --mount-sigma 0.01,0.5
      landfix calibrate mono camera:0 -o camera.yaml            a live camera, for a minute and a half
    """
    from calib.cameras import mono
    from calib.files import formats
    from calib.report import page, plots, verdict
    from estimator.commands.common.image_source import files_of
    from estimator.commands.common.views import gather
    from models.camera import StereoRig

    options.check_outputs(report_file or out, out, *map(Path, files_of(sources)))
    pattern, placed = options.board_of(board, square_mm, marker_mm, dictionary), mount_of(mount, mount_sigma)
    with progress("calibrate") as update:
        views, unused = gather(sources, topic, pattern, lambda f: update(0.8 * f))
        result = mono.calibrate([v for _, v in views], pattern, mono.Lens(lens.value), lambda f: update(0.8 + 0.2 * f))
    judged, tables = verdict.of_mono(result), [*page.mono_tables(result), page.dropped(unused)]
    if placed is None:
        written = formats.save_camera(out, result.camera)
    else:
        written = formats.save_mounted(out, StereoRig.of_one(result.camera, *placed))
    written += page.write(report_file or out, f"Camera {out.name}", judged, tables, plots.mono_figure(result))
    facts = {
        "rms_px": result.solution.rms, "held_out_rms_px": result.held_out.rms, "held_out_beyond": result.held_out.beyond,
        "camera": _camera(result.camera),
    }  # fmt: skip
    options.tell(judged, tables[:2], [*result.dropped, *unused], written, facts if json else None)


def stereo_command(
    left: Annotated[list[str], typer.Option(help="Left images: pattern, folder, video, log or camera:0; may be repeated.")],
    right: Annotated[list[str], typer.Option(help="Right images, taken at the same time.")],
    out: options.OutFile,
    board: options.BoardSize = "9x6",
    square_mm: options.SquareMm = 25.0,
    marker_mm: options.MarkerMm = 0.0,
    dictionary: options.Dictionary = "DICT_5X5_1000",
    lens: options.LensOption = options.LensChoice.FIVE,
    mount: Mount = "",
    mount_sigma: MountSigma = "0.02,1",
    left_topic: Annotated[str, typer.Option(help="In a log: topic of the left images.")] = "/left/image",
    right_topic: Annotated[str, typer.Option(help="In a log: topic of the right images.")] = "/right/image",
    report_file: options.ReportFile = None,
    json: Json = False,
) -> None:
    """Calibrate a stereo rig.

    Pairs are made by the number in the file names, by frame, or in a log by stamp. A camera with --mount 0,0,0,0,0,0 looks
    forward; pitch -90 looks down with the image's upper edge forward. Without --mount only the cameras' relative pose is known;
    landfix calibrate camera-imu estimates the rest.

    \b
    Examples:
      landfix calibrate stereo --left 'L*.jpg' --right 'R*.jpg' --board 9x6 --square-mm 25 -o rig.yaml
      landfix calibrate stereo --left left/ --right right/ -o rig.xml --mount 0.1,0,0.05,0,-90,0 --mount-sigma 0.01,0.5
      landfix calibrate stereo --left log.mcap --right log.mcap -o rig.yaml
    """
    from calib.cameras import mono, stereo
    from calib.files import formats
    from calib.report import page, plots, verdict
    from estimator.commands.common.image_source import files_of
    from estimator.commands.common.views import gather_pairs

    options.check_outputs(report_file or out, out, *map(Path, files_of([*left, *right])))
    pattern, placed = options.board_of(board, square_mm, marker_mm, dictionary), mount_of(mount, mount_sigma)
    with progress("calibrate") as update:
        pairs, unused = gather_pairs(left, right, (left_topic, right_topic), pattern, lambda f: update(0.8 * f))
        result = stereo.calibrate(pairs, pattern, mono.Lens(lens.value), lambda f: update(0.8 + 0.2 * f))
    judged, tables = verdict.of_stereo(result), [*page.stereo_tables(result), page.dropped(unused)]
    rig = _placed(result.rig, placed)
    written = formats.save_rig(out, rig)
    written += page.write(report_file or out, f"Stereo rig {out.name}", judged, tables, plots.stereo_figure(result))
    facts = _stereo_facts(result, rig) if json else None
    options.tell(judged, tables[:2], [*result.dropped, *unused], written, facts)


def convert_command(
    source: Annotated[Path, typer.Argument(metavar="RIG", help="A rig file in any form; of ROS either of the pair.")],
    out: options.OutFile,
    to: Annotated[options.FormatChoice | None, typer.Option(help="Format to write; default: from the file name.")] = None,
) -> None:
    """Convert a rig file to another format.

    Read and written: ours (with covariances), OpenCV XML/YAML, ROS camera_info (a pair of files), Kalibr camchain.

    \b
    Examples:
      landfix calibrate convert camchain.yaml -o rig.yaml
      landfix calibrate convert rig.yaml -o rig.xml
      landfix calibrate convert rig.yaml -o rig.yaml --to ros       writes rig_left.yaml and rig_right.yaml
    """
    from calib.files import formats

    written = formats.save_rig(out, formats.load_rig(source), formats.Format(to.value) if to else None)
    typer.echo(", ".join(str(path) for path in written))


def dlt_command(
    points: Annotated[Path, typer.Argument(metavar="POINTS.csv", help="Lines of X, Y, Z [m], u, v [px]: six points or more.")],
    json: Json = False,
) -> None:
    """Calibrate a camera from known points in space, not in one plane (DLT).

    Prints the camera matrix, what it is made of (intrinsics, location, orientation) and the residual. No lens distortion.

    \b
    Examples:
      landfix calibrate dlt points.csv --json
    """
    import numpy as np

    from calib.cameras import dlt

    x_o, px = _points(points)
    A = dlt.camera_matrix(x_o, px)
    parts, residual = dlt.decompose(A), dlt.project(A, x_o) - px
    rms = float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))
    facts = {
        "A": A.tolist(), "K": parts.K.tolist(), "R_co": parts.R_co.tolist(), "location_m": parts.p_o.tolist(),
        "pan_deg": float(np.rad2deg(parts.pan)), "tilt_deg": float(np.rad2deg(parts.tilt)), "rms_px": rms,
    }  # fmt: skip
    if json:
        print_json(facts)
        return
    for name, matrix in (("Camera matrix A", A), ("Intrinsics K", parts.K), ("Orientation R_co", parts.R_co)):
        print_table(name, [[f"{x:.6g}" for x in row] for row in matrix])
    location = ", ".join(f"{x:.4f}" for x in parts.p_o)
    print_table("Result", [
        ("location [m]", location), ("pan, tilt of the optical axis [deg]", f"{facts['pan_deg']:.3f}, {facts['tilt_deg']:.3f}"),
        ("residual RMS [px]", f"{rms:.3f}"),
    ])  # fmt: skip


def _points(path: Path) -> "tuple[Array, Array]":
    import numpy as np

    from calib.errors import CalibrationError
    from models.untrusted.file import content

    rows = []
    for k, line in enumerate(content(path).decode("utf-8", "replace").splitlines()):
        fields = line.replace(";", ",").split(",")
        try:
            numbers = [float(x) for x in fields]
        except ValueError:
            numbers = []
        if len(numbers) == 5 and np.isfinite(numbers).all():
            rows.append(numbers)
        elif line.strip() and k > 0:
            raise CalibrationError(f"{path}: line {k + 1}: needed: X, Y, Z, u, v")
    table = np.array(rows).reshape(-1, 5)
    return table[:, :3], table[:, 3:]


def _placed(rig: "StereoRig", mount: "BodyPose | None") -> "StereoRig":
    import msgspec

    return rig if mount is None else msgspec.structs.replace(rig, **mount._asdict())


def _camera(camera: Any) -> dict[str, Any]:
    import numpy as np

    sigma = np.sqrt(np.diagonal(camera.covariance)).tolist()
    numbers = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy", "distortion")}
    return {**numbers, "sigma": sigma}


def _stereo_facts(result: "Stereo", rig: "StereoRig") -> dict[str, Any]:
    return {
        "rms_px": result.solution.rms, "left_rms_px": result.solution.camera_rms(0),
        "right_rms_px": result.solution.camera_rms(1),
        "epipolar_before_px": result.epipolar_before_px, "row_error_px": result.epipolar_after_px,
        "held_out_row_error_px": result.held_out.rms, "held_out_beyond": result.held_out.beyond,
        "square_mm": 1e3 * result.square_m, "baseline_m": rig.baseline_m,
        "left": _camera(rig.left), "right": _camera(rig.right), "R_rc": rig.R_rc.tolist(), "t_rc_m": rig.t_rc.tolist(),
        "covariance_rc": None if rig.covariance_rc is None else rig.covariance_rc.tolist(),
        "E": result.E.tolist(), "F": result.F.tolist(),
    }  # fmt: skip
