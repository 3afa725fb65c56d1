"""Photos as drones write them: JPEG with EXIF and the maker's XMP."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image

from calib.files.rig_yaml import FORWARD
from models import so3
from models.messages import Array
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.render import render_pair
from vision.synthetic.scenes import Scene

DJI = {
    "drone-dji:AbsoluteAltitude": "+198.31", "drone-dji:RelativeAltitude": "+39.80", "drone-dji:GimbalRollDegree": "+0.00",
    "drone-dji:GimbalYawDegree": "+45.00", "drone-dji:GimbalPitchDegree": "-89.90", "drone-dji:FlightYawDegree": "+46.00",
}  # fmt: skip
SPACES = {
    "drone-dji": "http://www.dji.com/drone-dji/1.0/",
    "Camera": "http://pix4d.com/camera/1.0/",
    "drone-parrot": "http://www.parrot.com/drone-parrot/1.0/",
    "drone": "http://www.autelrobotics.com/drone/1.0/",
}


def packet(properties: Mapping[str, str], *, as_elements: bool = False) -> bytes:
    """XMP: properties as attributes, as DJI writes them, or as elements, as Parrot and senseFly do."""
    spaces = " ".join(f'xmlns:{name}="{space}"' for name, space in SPACES.items())
    attributes = "" if as_elements else " ".join(f'{name}="{value}"' for name, value in properties.items())
    elements = "".join(f"<{name}>{value}</{name}>" for name, value in properties.items()) if as_elements else ""
    return (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/">'
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f"<rdf:Description {spaces} {attributes}>{elements}</rdf:Description></rdf:RDF></x:xmpmeta>"
        f"{' ' * 200}<?xpacket end='w'?>"
    ).encode()


def exif(
    lat: float | None = None,
    lon: float | None = None,
    *,
    main: Mapping[int, Any] | None = None,
    camera: Mapping[int, Any] | None = None,
) -> Image.Exif:
    """EXIF with a position, tags of the main folder and tags of the camera's."""
    tags = Image.Exif()
    for number, value in {0x010F: "DJI" + "\0" * 20, 0x0110: "FC300S\0\0", **(main or {})}.items():
        tags[number] = value
    folder = tags.get_ifd(0x8769)
    folder.update(camera or {})
    if lat is not None and lon is not None:
        place = tags.get_ifd(0x8825)
        place.update({1: "N" if lat >= 0 else "S", 2: _dms(lat), 3: "E" if lon >= 0 else "W", 4: _dms(lon), 5: b"\0", 6: 198.3})
    return tags


def _dms(degrees: float) -> tuple[float, float, float]:
    minutes = 60.0 * (abs(degrees) % 1.0)
    return float(int(abs(degrees))), float(int(minutes)), 60.0 * (minutes % 1.0)


def save(path: Path, bgr: Any, tags: Image.Exif, xmp: bytes = b"") -> Path:
    """The photo."""
    Image.fromarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)).save(path, quality=95, exif=tags, xmp=xmp)
    return path


def of_scene(path: Path, scene: Scene, p_n: Array, euler: tuple[float, float, float], *, off: Array, seed: int = 1) -> Array:
    """What the left camera of a scene's rig sees from a pose of the body, with DJI's tags; returns where the camera was, p_nc.

    off: error of the tags: north, east, up [m]. The ground is at the map's origin.
    """
    R_nb = so3.matrix(so3.from_euler(*euler))
    left, _ = render_pair(scene.world, scene.rig, p_n, R_nb, Conditions(), np.random.default_rng(seed))
    p_nc, R_nc = scene.rig.camera_pose(p_n, R_nb)
    roll, pitch, yaw = map(math.degrees, so3.to_euler(so3.from_matrix(np.ascontiguousarray(R_nc @ FORWARD.T))))
    said = p_nc + off * np.array([1.0, 1.0, -1.0])
    lat, lon, alt = scene.map.frame.to_geodetic(said)
    camera = scene.rig_calibrated.left
    xmp = DJI | {
        "drone-dji:GimbalRollDegree": f"{roll:+.2f}", "drone-dji:GimbalPitchDegree": f"{pitch:+.2f}",
        "drone-dji:GimbalYawDegree": f"{yaw:+.2f}", "drone-dji:RelativeAltitude": f"{alt - scene.map.origin[2]:+.2f}",
        "drone-dji:CalibratedFocalLength": f"{camera.fx:.3f}",
    }  # fmt: skip
    save(path, left, exif(lat, lon), packet(xmp))
    return p_nc
