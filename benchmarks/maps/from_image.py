"""How many real footprints come out of a satellite image: `python -m benchmarks.maps.from_image`.

43 footprints in a panchromatic image of 0.5 m (SpaceNet, Atlanta: houses among trees), against the regions that `landfix map
build` takes from it, with colours of its own choice and with greys to look for. A region is right if its intersection with a
footprint is half of their union.
"""

import cv2
import numpy as np

from benchmarks.flights.tasks import data_folder
from estimator.map_files import orthophoto
from estimator.map_files import store as map_store
from estimator.tools.maps import from_image
from models.maps.landmarks import Landmark, LandmarkMap
from models.maps.table import Defaults
from models.messages import Array

LEAST_M2, RIGHT = 30.0, 0.5
GREYS = ((), (28,), (40,), (60,), (80,), (120,), (30, 55, 100, 180))
_CELL_M = 0.25


def overlap(a: Array, b: Array) -> float:
    """Intersection over union of two outlines (K, 2), on a grid of _CELL_M."""
    low, high = np.minimum(a.min(axis=0), b.min(axis=0)), np.maximum(a.max(axis=0), b.max(axis=0))
    rows, columns = (np.ceil((high - low) / _CELL_M).astype(int) + 3).tolist()
    masks = np.zeros((2, rows, columns), np.uint8)
    for mask, outline in zip(masks, (a, b), strict=True):
        cv2.fillPoly(mask, [np.rint((outline - low)[:, ::-1] / _CELL_M).astype(np.int32)], 1)
    return float(np.sum(masks[0] & masks[1]) / np.sum(masks[0] | masks[1]))


def best(marks: list[Landmark], others: LandmarkMap) -> Array:
    """(N,) the best overlap of each with one of the others."""
    near = [others.near(*mark.centre_n, 0.5 * mark.length_m) for mark in marks]
    return np.array([
        max((overlap(mark.outline_n, other.outline_n) for other in around), default=0.0)
        for mark, around in zip(marks, near, strict=True)
    ])  # fmt: skip


def main() -> None:
    """A line per choice of greys."""
    folder = data_folder() / "images" / "spacenet_atlanta_footprints"
    if not folder.is_dir():
        raise SystemExit(f"{folder} not found: set LANDFIX_DATA to the folder of recorded images")
    footprints = map_store.load(folder / "geotiff_labels.geojson")
    image = orthophoto.load(folder / "sample_geotiff.tif")
    print(f"{len(footprints)} footprints, a pixel of {from_image.resolution_m(image):.2f} m")
    for greys in GREYS:
        data = from_image.landmarks(image, tuple((grey,) * 3 for grey in greys), LEAST_M2)
        found = LandmarkMap.from_geojson(data, Defaults(origin=footprints.origin))
        recalled, right = best(list(footprints), found) >= RIGHT, best(list(found), footprints) >= RIGHT
        shares = f"recall {np.mean(recalled):.0%}, precision {np.mean(right):.1%}"
        print(f"greys {greys or 'its own'}: {len(found)} regions, {np.sum(recalled)} footprints found ({shares})")


if __name__ == "__main__":
    main()
