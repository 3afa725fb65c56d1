"""landfix locate."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from estimator.commands.common.console import Json, note, print_json, print_table, progress
from estimator.commands.common.mount import Mount, MountSigma, mount_of

if TYPE_CHECKING:
    from estimator.commands.photo.shots import Shot, Shots
    from estimator.map_files.image_file import ImageFile
    from models.camera import StereoRig
    from models.maps.landmarks import LandmarkMap
    from models.messages import Array, LandmarkFix
    from models.prior import Prior
    from vision.image.rectify import Image
    from vision.pipeline import Result
    from vision.recognisers import MapImage


_REMEDIES = {  # of outcomes without a fix
    "waiting": "give the next photos of the flight as well",
    "ambiguous": "have more landmarks in view, or narrow --prior-sigma",
    "not_found": "check --prior, --mount and the map (landfix map show), or add an orthophoto (--picture)",
    "no_pose": "check --prior, --rig and --mount, or have more landmarks in view",
    "prior_too_wide": "narrow --prior-sigma",
    "no_region": "narrow --prior-sigma so that outlines can be predicted, or add an orthophoto (--picture)",
    "swapped": "give LEFT first",
    "outside": "give a --picture of this place, or check --prior",
}
_AROUND_M, _NEAREST = 300.0, 20  # landmarks that tell how high the ground is


class LocateError(ValueError):
    """No fix, or nothing to make one of, in one line."""


def command(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="IMAGES...", help="Photos, folders or a video of one camera, in order; or LEFT [RIGHT] of a rig."),
    ],
    rig_file: Annotated[
        Path | None,
        typer.Option("--rig", metavar="RIG", help="Calibration of rig or camera (YAML or XML); else what the photo's tags tell."),
    ] = None,
    prior: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LAT,LON,ALT,ROLL,PITCH,YAW",
            help="Prior pose of the vehicle: deg, m above the ellipsoid, deg. One for all photos, or repeated, one for each; "
            "else what each photo's tags tell.",
        ),
    ] = None,
    map_file: Annotated[Path | None, typer.Option("--map", metavar="MAP", help="Landmark map (landfix map build).")] = None,
    mount: Mount = "",
    mount_sigma: MountSigma = "0.02,1",
    prior_sigma: Annotated[
        str,
        typer.Option(
            metavar="M,DEG|H,V,TILT,YAW",
            help="Standard deviation of the prior: each axis (10,2 with --prior), or m horizontally and vertically, and deg.",
        ),
    ] = "",
    height_m: Annotated[
        float | None, typer.Option(min=1, max=5000, help="Height above the ground, in place of that in the photos' tags.")
    ] = None,
    camera_pitch: Annotated[
        float | None,
        typer.Option(
            min=-90,
            max=0,
            metavar="DEG",
            help="Pitch of a camera without a gimbal, -90 is down; the heading is the aircraft's.",
        ),
    ] = None,
    width: Annotated[
        int | None, typer.Option(min=320, max=20_000, help="Photos are scaled to it [px]; 800 where tags tell of the camera.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="IMAGE", help="Orthophoto or satellite image: GeoTIFF, or with a world file.")
    ] = None,
    picture_sigma_m: Annotated[float, typer.Option(min=0, help="Standard deviation of its horizontal position, per axis.")] = 1.0,
    picture_height_m: Annotated[
        float | None, typer.Option(help="Height of its ground above the ellipsoid; default: that of the map's origin.")
    ] = None,
    picture_height_sigma_m: Annotated[float, typer.Option(min=0, help="Standard deviation of the height of its ground.")] = 2.0,
    picture_heights: Annotated[
        Path | None, typer.Option(metavar="RASTER", help="GeoTIFF or image with a world file: heights above the ellipsoid [m].")
    ] = None,
    picture_epsg: Annotated[
        int, typer.Option(metavar="CODE", help="EPSG code of a raster without one: 4326, 326xx, 327xx, 3857.")
    ] = 0,
    learned: Annotated[
        str, typer.Option(metavar="XFEAT,LIGHTERGLUE", help="ONNX files for learned matching with the picture: landfix[learned].")
    ] = "",
    within_m: Annotated[
        float | None,
        typer.Option("--within", metavar="M", help="Fail unless the 95 % radius of the position is at most M metres."),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="PNG of the left image, the map drawn into it.")] = None,
    json: Json = False,
) -> None:
    """Locate the vehicle: a fix from photos of a drone, a video, one image, or a stereo pair.

    Without --prior a photo's own tags (EXIF, and XMP of DJI, Autel, Parrot, senseFly) give position, height above the take-off
    point and the camera's angles; the vehicle is the camera then. Without --rig they give the camera, too, less exactly.
    A camera file of landfix calibrate mono with --prior needs --mount: the mount of the photo as a viewer shows it (0,0,0,0,-90,0
    looks down with the photo's upper edge forward). Photos of another size are scaled if their aspect ratio is the camera's. A
    video begins at --prior, and its later frames at the last fix.

    Regions are matched with the map near the prior; without a match the left image is registered with the orthophoto. The fix is
    that of the images alone; "with the prior" combines both. The exit code is 1 if there is no fix, or with --within if none
    combined with the prior is accurate enough.

    \b
    Examples:
      landfix locate DJI_0001.JPG --map town.geojson -o seen.png
      landfix locate flight/ --map town.geojson --rig camera.yaml
      landfix locate left.png right.png --rig rig.yaml --map town.geojson --prior 47.3977,8.5456,560,0,0,90 --within 2
      landfix locate left.png --rig rig.yaml --picture ortho.tif --picture-height-m 455 --prior 47.3977,8.5456,560,0,0,90
    """
    from estimator.commands.photo.shots import Given, check, take
    from estimator.map_files.image_file import ImageFile, LearnedFiles

    given = Given(files, rig_file, mount_of(mount, mount_sigma), prior or [], prior_sigma, height_m, camera_pitch, width)
    check(given)
    if within_m is not None and not within_m > 0.0:
        raise typer.BadParameter(f"--within {within_m:g} must be above 0")
    if map_file is None and picture is None:
        raise typer.BadParameter("a map is needed: --map, --picture, or both")
    known = None
    if picture is not None:
        models = [Path(name) for name in learned.split(",")] if learned else []
        if len(models) not in {0, 2}:
            raise typer.BadParameter(f"--learned {learned}: needs two files, XFEAT,LIGHTERGLUE")
        known = ImageFile(
            picture, picture_sigma_m, picture_height_m, picture_height_sigma_m, picture_heights, picture_epsg,
            LearnedFiles(models[0], models[1]) if models else None,
        )  # fmt: skip
    landmarks, map_image = _map(map_file, known)
    shots = take(given, landmarks.frame, lambda north, east: _ground_d(landmarks, map_image, north, east))
    for remark in shots.remarks:
        note(remark)
    results = _results(rig_file, shots, landmarks, map_image)
    shot, result = next((one for one in reversed(results) if one[1].fix is not None), results[-1])
    start = shot.prior
    if out is not None:
        _write_overlay(out, shot.left, shots.rig, landmarks, start, result)
    answer = _as_json(landmarks, start, result)
    if len(results) > 1:
        answer["photo"] = shot.name
        answer["photos"] = [_photo_json(landmarks, *one) for one in results]
    if json:
        print_json(answer)
    else:
        _print(answer, result)
    if result.report.outcome == "no_landmark_near":
        raise LocateError(f"no fix: no_landmark_near: {_how_far(landmarks, start)}")
    if result.fix is None:
        said = (result.report.outcome, result.report.detail, _REMEDIES.get(result.report.outcome, ""))
        raise LocateError(f"no fix: {': '.join(text for text in said[:2] if text)}" + (f"; {said[2]}" if said[2] else ""))
    known_m = answer["with_prior"]["within_m"]
    if within_m is not None and not known_m <= within_m:
        raise LocateError(f"no fix good to {within_m:g} m: with the prior it is good to {known_m:.2f} m (95 %)")


def _results(
    rig_file: Path | None, shots: "Shots", landmarks: "LandmarkMap", map_image: "MapImage | None"
) -> "list[tuple[Shot, Result]]":
    from vision.recognisers import Recognisers

    try:
        recognisers = Recognisers(shots.rig, landmarks, map_image)
    except ValueError as error:
        raise LocateError(f"{rig_file or 'camera'}: {error}") from None
    results: list[tuple[Shot, Result]] = []
    with progress("locate") as report:
        for k, shot in enumerate(shots.images):
            report(k / shots.total, Path(shot.name).name)
            shot = _following(shot, results)  # noqa: PLW2901
            results.append((shot, recognisers.process(shot.left, shot.right, shot.t_ns, shot.prior)))
    return results


def _following(shot: "Shot", before: "list[tuple[Shot, Result]]") -> "Shot":
    import numpy as np

    from models import so3
    from models.prior import Prior

    pose = next((result.pose for _, result in reversed(before) if result.pose is not None), None)
    if not shot.follows or pose is None:
        return shot
    q_nb = so3.normalise(so3.from_matrix(np.ascontiguousarray(pose.joint_R_nb)))
    return shot._replace(prior=Prior(pose.joint_p_n, q_nb, shot.prior.covariance))


def _map(map_file: Path | None, known: "ImageFile | None") -> "tuple[LandmarkMap, MapImage | None]":
    from estimator.map_files import image as image_store
    from estimator.map_files import store as map_store
    from models.maps.landmarks import LandmarkMap

    if map_file is not None:
        landmarks = map_store.load(map_file)
        if not len(landmarks) and known is None:
            raise LocateError(f"{map_file}: no usable landmark (landfix map check says why)")
    else:
        assert known is not None
        landmarks = LandmarkMap.from_landmarks(image_store.origin(known), [])
    return landmarks, image_store.load(known, landmarks.origin) if known else None


def _ground_d(landmarks: "LandmarkMap", known: "MapImage | None", north: float, east: float) -> float:
    import numpy as np

    rows = landmarks.rows_near(north, east, _AROUND_M)[:_NEAREST]
    if len(rows):
        return float(np.median(landmarks.columns.base_d[rows]))
    return 0.0 if known is None else float(known.image.heights.at(np.array([[north, east]]))[0])


def _how_far(landmarks: "LandmarkMap", prior: "Prior") -> str:
    import numpy as np

    def nearest_m(place: "Array") -> float:
        return float(np.hypot(*(landmarks.columns.vertices - place[:2]).T).min())

    lat, lon, alt = landmarks.frame.to_geodetic(prior.p_n)
    here_m = nearest_m(prior.p_n)
    text = (
        f"the nearest landmark is {here_m / 1e3:.1f} km from --prior"
        if here_m > 1e3
        else f"the nearest one is {here_m:.0f} m away"
    )
    if abs(lon) <= 90.0 and nearest_m(np.array(landmarks.frame.to_ned(lon, lat, alt))) < 0.01 * here_m:
        return f"{text}; with latitude and longitude exchanged it is near: give LAT,LON"
    return f"{text}, none comes into view: check --prior, --prior-sigma and --mount"


def _joint(prior: "Prior", fix: "LandmarkFix") -> "tuple[Array, Array, Array]":
    import numpy as np

    from models import so3
    from vision.pose.pose import combine

    common = 0.0 if fix.covariance_common is None else fix.covariance_common
    return combine(
        prior, np.array(fix.p_n), so3.matrix(np.array(fix.q_nb_wxyz)), fix.covariance + common, fix.directions, fix.readings
    )


def _pose_json(landmarks: "LandmarkMap", p_n: "Array", q_nb: "Array", covariance: "Array") -> dict[str, Any]:
    import numpy as np

    from models import so3
    from models.radius import reach

    lat, lon, alt = landmarks.frame.to_geodetic(p_n)
    sigma = np.sqrt(np.diag(covariance))
    return {
        "lat_deg": lat,
        "lon_deg": lon,
        "alt_m": alt,
        **dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), map(math.degrees, so3.to_euler(q_nb)), strict=True)),
        "p_n_m": [float(x) for x in p_n],
        "q_nb_wxyz": [float(x) for x in q_nb],
        "sigma_north_east_down_m": sigma[:3].tolist(),
        "sigma_rotation_deg": np.degrees(sigma[3:]).tolist(),
        "within_m": reach(covariance[:3, :3]),
        "covariance": covariance.tolist(),
    }


def _as_json(landmarks: "LandmarkMap", prior: "Prior", result: "Result") -> dict[str, Any]:
    import msgspec
    import numpy as np

    from models import so3

    fix, report = result.fix, result.report
    answer: dict[str, Any] = {"outcome": report.outcome, "detail": report.detail, "fix": None, "with_prior": None}
    if fix is not None:
        common = np.zeros((6, 6)) if fix.covariance_common is None else fix.covariance_common
        answer["fix"] = {
            **_pose_json(landmarks, np.array(fix.p_n), np.array(fix.q_nb_wxyz), fix.covariance + common),
            "covariance_common": common.tolist(),
            "landmarks": list(fix.landmarks),
            "similarity": fix.similarity,
            "residual_px": fix.residual_px,
        }
        p_n, R_nb, covariance = _joint(prior, fix)
        answer["with_prior"] = _pose_json(landmarks, p_n, so3.from_matrix(np.ascontiguousarray(R_nb)), covariance)
    answer["regions"] = [msgspec.structs.asdict(region) for region in result.regions]
    return answer


def _photo_json(landmarks: "LandmarkMap", shot: "Shot", result: "Result") -> dict[str, Any]:
    found: dict[str, Any] = {"file": shot.name, "outcome": result.report.outcome, "detail": result.report.detail}
    if result.fix is not None:
        pose = _as_json(landmarks, shot.prior, result)["with_prior"]
        found |= {key: pose[key] for key in ("lat_deg", "lon_deg", "alt_m", "within_m")}
    return found


def _print(answer: dict[str, Any], result: "Result") -> None:
    if "photos" in answer:
        rows = [
            (
                Path(p["file"]).name,
                p["outcome"].replace("_", " "),
                f"{p['within_m']:.2f} m" if "within_m" in p else "-",
                p["detail"],
            )
            for p in answer["photos"]
        ]
        print_table("Photos", rows, ("photo", "outcome", "known to (95 %)", "why"))
        typer.echo(f"{answer['photo']}:")
    if result.regions:
        rows = [
            (r.landmark or "-", r.state.replace("_", " "), f"{r.similarity:.0%}" if r.similarity else "-", r.reason)
            for r in result.regions
        ]
        print_table("Regions", rows, ("landmark", "state", "similarity", "why"))
    for title, pose in (("The images alone", answer["fix"]), ("With the prior", answer["with_prior"])):
        if pose is not None:
            print_table(title, _pose_rows(pose))
    if result.fix is not None:
        note(f"{result.report.detail}; they fit to {result.fix.residual_px:.2f} px")


def _pose_rows(pose: dict[str, Any]) -> list[tuple[str, str]]:
    north, east, down = pose["sigma_north_east_down_m"]
    return [
        ("latitude", f"{pose['lat_deg']:.7f} deg ± {north:.2f} m"),
        ("longitude", f"{pose['lon_deg']:.7f} deg ± {east:.2f} m"),
        ("height above ellipsoid", f"{pose['alt_m']:.2f} ± {down:.2f} m"),
        ("known to (95 %)", f"{pose['within_m']:.2f} m"),
        ("roll, pitch, yaw", ", ".join(f"{pose[k]:.2f}" for k in ("roll_deg", "pitch_deg", "yaw_deg")) + " deg"),
        ("± about north, east, down", ", ".join(f"{x:.2f}" for x in pose["sigma_rotation_deg"]) + " deg"),
    ]


def _write_overlay(
    path: Path, image: "Image", rig: "StereoRig", landmarks: "LandmarkMap", prior: "Prior", result: "Result"
) -> None:
    import cv2

    from vision.describe.survey import to_8_bit
    from vision.show.overlay import draw_overlay, outline_residuals

    canvas = to_8_bit(image)
    p_n, R_nb = (prior.p_n, prior.R_nb) if result.fix is None else _joint(prior, result.fix)[:2]
    p_nc, R_nc = rig.camera_pose(p_n, R_nb)
    near = landmarks.near(float(p_nc[0]), float(p_nc[1]), 300.0)
    used = result.fix.landmarks if result.fix is not None else ()
    caption = [f"{result.report.outcome}: {result.report.detail}" if result.fix is None else result.report.detail]
    if result.fix is None:
        caption.append("drawn from the prior")
    residuals = outline_residuals(canvas, rig.left, p_nc, R_nc, [m for m in near if m.id in used]) if used else []
    drawn = draw_overlay(canvas, rig.left, p_nc, R_nc, near, used, residuals, caption)
    done, png = cv2.imencode(".png", drawn)
    if not done:
        raise LocateError(f"{path}: the image could not be encoded")
    path.write_bytes(png.tobytes())
