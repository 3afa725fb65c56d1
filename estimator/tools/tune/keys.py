"""Keys that `landfix tune` may vary."""

import re
from collections.abc import Collection, Iterable
from typing import Final, NamedTuple

import numpy as np

from estimator.config import Config, ConfigError

Values = dict[str, float]


class Key(NamedTuple):
    """A key and its bounds; needs: what a log must hold for it ("" always)."""

    name: str
    low: float
    high: float
    needs: str = ""

    @property
    def is_noise(self) -> bool:
        """Whether more of it makes the covariance wider."""
        return "noise" in self.name or "walk" in self.name or "sigma" in self.name


_NOISE: Final = (
    Key("imu.gyro_noise", 2e-5, 5e-2),
    Key("imu.accel_noise", 2e-4, 3.0),
    Key("imu.gyro_walk", 1e-7, 1e-2),
    Key("imu.accel_walk", 1e-6, 1e-1),
    Key("pose_fix.noise_scale", 0.2, 5.0, "pose_fix"),
    Key("landmark_fix.noise_scale", 0.2, 5.0, "landmark_fix"),
    Key("drag.momentum_1_s", 0.02, 2.0, "drag"),
    Key("wind.gust_m_s", 0.1, 5.0, "wind"),
)
_TRUTH: Final = (Key("gnss.slow_sigma_m", 0.01, 10.0, "gnss"),)  # not identifiable from the receiver itself
KEYS: Final = {key.name: key for key in (*_NOISE, *_TRUTH)}


def chosen(sources: Collection[str], named: Iterable[str] = (), truth: bool = False) -> list[Key]:
    """Named keys, else all noise parameters in use. Raises ConfigError."""
    names = list(named)
    if unknown := [name for name in names if name not in KEYS]:
        raise ConfigError(f"--vary {unknown[0]}: cannot be tuned; there are {', '.join(KEYS)}")
    if names:
        return [KEYS[name] for name in names]
    wanted = (*_NOISE, *(_TRUTH if truth else ()))
    return [key for key in wanted if not key.needs or key.needs in sources]


def value_of(config: Config, key: Key) -> float:
    """The value in the configuration."""
    section, _, name = key.name.partition(".")
    return float(getattr(getattr(config, section), name))


def to_search(key: Key, value: float) -> float:
    """log10 of the value, inside the bounds."""
    return float(np.log10(np.clip(value, key.low, key.high)))


def from_search(key: Key, place: float) -> float:
    """The value at a place of the search, to three digits."""
    return float(np.clip(float(f"{10.0**place:.3g}"), key.low, key.high))


def bounds(key: Key) -> tuple[float, float]:
    """Of the search."""
    low, high = sorted((to_search(key, key.low), to_search(key, key.high)))
    return low, high


def written(text: str, values: Values) -> str:
    """A TOML text with these keys set, otherwise unchanged."""
    lines = text.splitlines()
    for name, value in values.items():
        section, _, key = name.partition(".")
        start = next((k for k, line in enumerate(lines) if re.match(rf"\s*\[\s*{section}\s*\]", line)), None)
        if start is None:
            lines += ([""] if lines and lines[-1] else []) + [f"[{section}]", f"{key} = {value!r}"]
            continue
        end = next((k for k in range(start + 1, len(lines)) if re.match(r"\s*\[", lines[k])), len(lines))
        at = next((k for k in range(start + 1, end) if re.match(rf"\s*{key}\s*=", lines[k])), None)
        if at is None:
            last = max(k for k in range(start, end) if lines[k].strip())
            lines.insert(last + 1, f"{key} = {value!r}")
        else:
            comment = lines[at][lines[at].index("#") :] if "#" in lines[at] else ""
            lines[at] = f"{key} = {value!r}" + (f"  {comment}" if comment else "")
    return "\n".join(lines) + "\n"
