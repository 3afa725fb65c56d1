"""Photos with nothing but their tags: `python -m benchmarks.aerial.tagged [--width 800]`.

Brighton Beach by `landfix locate PHOTO --map MAP`: pose and camera by EXIF and XMP from photos.csv, or a calibrated camera. 12
photos are original; 6, turned by a viewer, are decoys. Judged: the camera's position by fix and prior, against SIFT in the
orthophoto of the same photos.
"""

import argparse
import csv
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

import cv2
import numpy as np
from PIL import Image

from benchmarks.aerial import brighton
from benchmarks.aerial.registration_sets import brighton_files
from benchmarks.aerial.trials import generator, turned
from benchmarks.flights.tasks import data_folder
from benchmarks.tables import Table, number
from calib.files.formats import save_camera
from estimator.commands.photo.shots import Given, take
from estimator.map_files import image as image_store
from models.maps.landmarks import LandmarkMap
from models.messages import Array
from models.prior import Prior
from models.radius import reach
from vision.pipeline import Result
from vision.recognisers import MapImage, Recognisers

_VIEWER: Final = "Microsoft Windows Photo Viewer 10.0.10240.16384"
_TURNED: Final = frozenset(f"DJI_00{k}.jpg" for k in range(24, 30))
_FOCAL_35_MM, _TAKEN_PX = 20, (4000, 2250)
_WIDTH: Final = 800  # the command's default
_TAKEN, _SOFTWARE = 0x9003, 0x0131


class Row(NamedTuple):
    """What became of a photo: accepted, horizontal error of prior and fix, 95 % radius, NEES / 2 and error of all three."""

    accepted: bool
    prior_m: float
    error_m: float = math.nan
    within_m: float = math.nan
    squared: float = math.nan
    error_3d_m: float = math.nan


def tagged(data: Path, name: str, out: Path) -> Path:
    """A photo of the set with the tags that the camera wrote."""
    with (data / brighton.FOLDER / "photos.csv").open() as file:
        row = next(row for row in csv.DictReader(file) if row["file"] == name)
    exif = Image.Exif()
    exif[0x010F], exif[0x0110] = "DJI", "FC300S"
    exif[_SOFTWARE] = _VIEWER if name in _TURNED else "v01.23.4920"
    exif.get_ifd(0x8769).update({
        _TAKEN: row["time_local"], 0x920A: 3.61, 0xA405: _FOCAL_35_MM, 0xA002: _TAKEN_PX[0], 0xA003: _TAKEN_PX[1],
    })  # fmt: skip
    lat, lon = float(row["lat_deg"]), float(row["lon_deg"])
    exif.get_ifd(0x8825).update({1: "N", 2: _dms(lat), 3: "W", 4: _dms(-lon), 5: b"\0", 6: float(row["alt_abs_m"])})
    names = {"AbsoluteAltitude": "alt_abs_m", "RelativeAltitude": "alt_rel_m", "GimbalRollDegree": "gimbal_roll_deg",
             "GimbalYawDegree": "gimbal_yaw_deg", "GimbalPitchDegree": "gimbal_pitch_deg"}  # fmt: skip
    written = " ".join(f'drone-dji:{tag}="{row[column]}"' for tag, column in names.items())
    xmp = (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" {written}/></rdf:RDF></x:xmpmeta>'
    )
    with Image.open(data / brighton.FOLDER / "photo" / name) as photo:
        photo.save(out / name, quality=95, exif=exif, xmp=xmp.encode())
    return out / name


def _dms(degrees: float) -> tuple[float, float, float]:
    minutes = 60.0 * (degrees % 1.0)
    return float(int(degrees)), float(int(minutes)), 60.0 * (minutes % 1.0)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.aerial.tagged", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--width", type=int, default=_WIDTH, help="of the photos [px]")
    args = parser.parse_args()
    data = data_folder()
    if not (data / brighton.FOLDER).is_dir():
        raise SystemExit(f"{data / brighton.FOLDER} not found: set LANDFIX_DATA to the folder of recorded images")
    cv2.setNumThreads(1)
    with TemporaryDirectory() as folder:
        table = Table("Photos with their tags", _COLUMNS, list(_rows(data, Path(folder), args.width)))
    sys.stdout.write(table.markdown())


_COLUMNS = (
    "map", "photos", "camera", "accepted", "median m", "worst m", "3D median m", "prior, median m", "NEES / 2", "within 95 %",
)  # fmt: skip


def _rows(data: Path, folder: Path, width: int) -> Iterator[tuple[str, ...]]:
    marks = brighton.landmark_map()
    names = brighton.photo_names(data)
    references = {name: (w.p_nc, w.R_nc) for name, w in brighton.references(data, marks, names).items()}
    known = image_store.load(brighton_files(data, folder / "maps"), marks.origin)
    around = np.mean([p_nc[:2] for p_nc, _ in references.values()], axis=0)
    decoy = LandmarkMap.from_landmarks(marks.origin, turned(list(marks), around, generator(0, "tagged", 0)))
    nothing = LandmarkMap.from_landmarks(marks.origin, [])
    as_written = [name for name in names if name not in _TURNED and name in references]
    by_viewer = [name for name in names if name in _TURNED and name in references]
    calibrated = folder / "camera.yaml"
    save_camera(calibrated, brighton.camera())
    photos = {name: tagged(data, name, folder) for name in (*as_written, *by_viewer)}
    maps: tuple[tuple[str, LandmarkMap, MapImage | None], ...] = (
        ("outlines", marks, None), ("orthophoto", nothing, known), ("outlines, map turned", decoy, None)
    )  # fmt: skip
    for said, landmarks, image in maps:
        for kind, group in (("as written", as_written), ("turned by a viewer", by_viewer)):
            for how, rig in (("by its tags", None), ("calibrated", calibrated)):
                files = [photos[name] for name in group]
                found = _locate(files, rig, width, marks, landmarks, image)
                yield _summary(
                    said, kind, how, [_judge(*one, references[name][0]) for name, one in zip(group, found, strict=True)]
                )


def _locate(
    files: Sequence[Path], rig: Path | None, width: int, ground: LandmarkMap, landmarks: LandmarkMap, image: MapImage | None
) -> Iterator[tuple[Prior, Result]]:
    """What the command finds in each photo alone."""
    down = float(np.median(ground.columns.base_d))
    shots = take(Given(files, rig, None, [], "", None, None, width), landmarks.frame, lambda north, east: down)  # noqa: ARG005
    for shot in shots.images:
        yield shot.prior, Recognisers(shots.rig, landmarks, image).process(shot.left, None, shot.t_ns, shot.prior)


def _judge(prior: Prior, result: Result, true_n: Array) -> Row:
    """The body is the camera."""
    prior_m = float(np.linalg.norm((prior.p_n - true_n)[:2]))
    if result.pose is None or result.fix is None:
        return Row(False, prior_m)
    e, P = result.pose.joint_p_n - true_n, result.pose.joint_covariance
    squared = float(e[:2] @ np.linalg.solve(P[:2, :2], e[:2])) / 2.0
    return Row(True, prior_m, float(np.linalg.norm(e[:2])), reach(P[:3, :3]), squared, float(np.linalg.norm(e)))


def _summary(said: str, kind: str, how: str, rows: Sequence[Row]) -> tuple[str, ...]:
    fixes = [row for row in rows if row.accepted]
    errors = np.array([row.error_m for row in fixes] or [math.nan])
    inside = f"{sum(row.error_3d_m <= row.within_m for row in fixes)} of {len(fixes)}"
    return (
        said, f"{len(rows)} {kind}", how, str(len(fixes)), number(float(np.median(errors))), number(float(errors.max())),
        number(float(np.median([row.error_3d_m for row in fixes] or [math.nan]))),
        number(float(np.median([row.prior_m for row in rows]))),
        number(float(np.mean([row.squared for row in fixes] or [math.nan]))), inside,
    )  # fmt: skip


if __name__ == "__main__":
    main()
