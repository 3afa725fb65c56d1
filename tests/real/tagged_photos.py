"""Brighton Beach's photos with the tags that their camera wrote: EXIF and XMP by photos.csv."""

import csv
from pathlib import Path
from typing import Final

from PIL import Image

from benchmarks.aerial import brighton

_VIEWER: Final = "Microsoft Windows Photo Viewer 10.0.10240.16384"  # it turned six photos and left their tags
_TURNED: Final = frozenset(f"DJI_00{k}.jpg" for k in range(24, 30))
_FOCAL_35_MM, _TAKEN_PX = 20, (4000, 2250)
_TAKEN, _SOFTWARE = 0x9003, 0x0131


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
