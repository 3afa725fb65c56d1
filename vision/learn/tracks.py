"""Tracks to landmarks."""

from collections import Counter
from dataclasses import dataclass

import msgspec
import numpy as np

from models.maps import outline as polygon
from models.maps.landmarks import Landmark
from models.messages import Array
from vision.learn.mapping import Mapper, Position, Track
from vision.learn.median_outline import merged_outline

_CELLS = 2.0  # a pixel, of the grid on which outlines vote
_EDGE_PX = 0.4  # of all edges alike: blur, shadow along one side


class KeepConfig(msgspec.Struct, frozen=True):
    """most_chi2: per degree of freedom; least_agreement: of outlines; painted_sigma: within so many sigmas a roof is on the
    ground.
    """

    least_frames: int = 4
    least_m2: float = 15.0
    most_sigma_m: float = 2.0
    most_height_sigma_m: float = 3.0
    most_chi2: float = 4.0
    least_agreement: float = 0.9
    painted_sigma: float = 2.0


@dataclass(frozen=True, slots=True)
class Learned:
    """Landmarks, images of each, tracks left out; common (3, 3): covariance common to the map."""

    landmarks: list[Landmark]
    seen: list[int]
    left_out: dict[str, int]
    common: Array


def learned(mapper: Mapper, ground_d: float, config: KeepConfig | None = None) -> Learned:
    """The landmarks of all observations so far; ground_d: down of the ground, which is flat."""
    config = config or KeepConfig()
    tracks = sorted(_united(mapper), key=lambda track: -len(track.observations))
    positions = [mapper.position(track) for track in tracks]
    flaws = [_flaw(track, position, config) for track, position in zip(tracks, positions, strict=True)]
    sound = [position.F for position, flaw in zip(positions, flaws, strict=True) if not flaw]
    shared = np.mean(sound, axis=0) if sound else np.zeros((3, 1))
    marks, seen, left_out = list[Landmark](), list[int](), Counter[str]()
    for track, position, flaw in zip(tracks, positions, flaws, strict=True):
        apart = position.own + (position.F - shared) @ (position.F - shared).T + mapper.config.drift_m**2 * np.eye(3)
        mark = flaw or _landmark(f"L{len(marks) + 1}", track, position, apart, ground_d, config)
        if isinstance(mark, Landmark) and any(_overlap(mark, other) for other in marks):
            mark = "on another one that was seen more often"
        if isinstance(mark, str):
            left_out[mark] += 1
        else:
            marks.append(mark)
            seen.append(len(track.observations))
    return Learned(marks, seen, dict(left_out), shared @ shared.T)


def _united(mapper: Mapper) -> list[Track]:
    united = list[Track]()
    for track in sorted(mapper.tracks, key=lambda t: -len(t.observations)):
        frames = {one.frame for one in track.observations}
        same = (t for t in united if frames.isdisjoint(one.frame for one in t.observations) and mapper.same(t, track))
        if (first := next(same, None)) is None:
            united.append(track)
        else:
            for one in track.observations:
                first.add(one)
    return united


def _flaw(track: Track, position: Position, config: KeepConfig) -> str:
    sigma = np.sqrt(np.diag(position.covariance))
    if len(track.observations) < config.least_frames:
        return f"seen in fewer than {config.least_frames} images"
    if position.chi2 > config.most_chi2:
        return "not at one position: it moves, or is several things"
    if max(sigma[:2]) > config.most_sigma_m or sigma[2] > config.most_height_sigma_m:
        return "its position is not known well enough"
    return ""


def _landmark(name: str, track: Track, position: Position, apart: Array, ground_d: float, config: KeepConfig) -> Landmark | str:
    roof_d = float(position.position_n[2])
    outlines = [one.outline_at(roof_d) for one in track.observations]
    pixel_m = float(np.median([one.pixel_m for one in track.observations]))
    merged = merged_outline(outlines, pixel_m / _CELLS)
    if merged is None or merged.agreement < config.least_agreement:
        return "its outlines differ from side to side, as those of walls do"
    outline = merged.outline
    if polygon.area(outline) < config.least_m2:
        return f"smaller than {config.least_m2:g} m2"
    height = ground_d - roof_d
    on_ground = height < config.painted_sigma * float(np.sqrt(position.covariance[2, 2]))
    blue, green, red = np.median([one.colour_bgr for one in track.observations], axis=0).round().astype(int).tolist()
    return Landmark.of(
        name,
        outline + position.position_n[:2],
        roof_d if on_ground else ground_d,
        0.0 if on_ground else height,
        (blue, green, red),
        float(np.sqrt(0.5 * np.trace(apart[:2, :2]))),
        float(np.sqrt(apart[2, 2])),
        _outline_sigma(track, outline, outlines, float(np.sqrt(position.own[2, 2])), pixel_m),
    )


def _outline_sigma(track: Track, outline: Array, outlines: list[Array], height_sigma_m: float, pixel_m: float) -> float:
    size, perimeter = polygon.area(outline), float(np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1).sum())
    scatter = float(np.std([polygon.area(o) for o in outlines])) / perimeter / np.sqrt(len(outlines))
    distance = float(np.median([track.position[2] - one.p_nc[2] for one in track.observations]))
    nearer = 2.0 * size / perimeter * height_sigma_m / max(distance, 1.0)
    return float(np.sqrt((_EDGE_PX * pixel_m) ** 2 + scatter**2 + nearer**2))


def _overlap(a: Landmark, b: Landmark) -> bool:
    if np.hypot(*(np.array(a.centre_n) - b.centre_n)) > 0.5 * (a.length_m + b.length_m):
        return False
    return polygon.contains(a.outline_n, *b.centre_n) or polygon.contains(b.outline_n, *a.centre_n)
