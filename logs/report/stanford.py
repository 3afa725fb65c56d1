"""Stanford plot as SVG: error against protection level, counts by colour."""

from typing import Final

import numpy as np

from logs.evaluation.integrity import regions
from models.messages import Array

_SIDE, _LEFT, _UNDER, _OVER = 320.0, 52.0, 42.0, 26.0  # px
_CELLS: Final = 64
_INK, _BAD, _OFF = "#5d666e", "#d55e00", "#e69f00"
_HALO: Final = 'paint-order="stroke" stroke="#fff" stroke-opacity="0.8" stroke-width="3"'  # words may stand on cells
_LOWEST_M: Final = 0.01
_DECADES: Final = (0.01, 0.1, 1.0, 10.0, 100.0, 1000.0, 10_000.0)
_SHADES: Final = ("#9ecae9", "#56b4e9", "#2a8fd0", "#0072b2", "#00497a", "#002a47")  # 1, 10, 100, ... in a cell


def stanford(error: Array, level: Array, limit_m: float, title: str) -> str:
    """Plot errors (n,) against levels (n,) [m], logarithmic and clipped; limit_m: inf: none."""
    finite = level[np.isfinite(level)]
    most = max([10.0, *(finite.tolist()), *(error.tolist()), *([limit_m] if np.isfinite(limit_m) else [])])
    highest = next((d for d in _DECADES if d > most), _DECADES[-1])
    span = np.log10(highest / _LOWEST_M)

    def scaled(x: Array) -> Array:
        shown = np.where(np.isfinite(x), x, highest)
        return np.asarray(np.clip(np.log10(np.maximum(shown, _LOWEST_M) / _LOWEST_M) / span, 0.0, 1.0))

    def x_px(metres: float) -> float:
        return _LEFT + _SIDE * float(scaled(np.array(metres)))

    def y_px(metres: float) -> float:
        return _OVER + _SIDE * (1.0 - float(scaled(np.array(metres))))

    right, bottom = _LEFT + _SIDE, _OVER + _SIDE
    parts = [
        _polygon([(_LEFT, bottom), (right, bottom), (right, _OVER)], _BAD, 0.13),
        *([_polygon([(_LEFT, _OVER), (right, _OVER), (right, y_px(limit_m)), (_LEFT, y_px(limit_m))], _OFF, 0.13)]
          if np.isfinite(limit_m) else []),
    ]  # fmt: skip
    counts = np.histogram2d(scaled(error), scaled(level), bins=_CELLS, range=[[0.0, 1.0], [0.0, 1.0]])[0].astype(int)
    size = _SIDE / _CELLS
    for column, row in np.argwhere(counts):
        shade = _SHADES[min(int(np.log10(counts[column, row])), len(_SHADES) - 1)]
        parts.append(
            f'<rect x="{_LEFT + column * size:.1f}" y="{bottom - (row + 1) * size:.1f}" width="{size:.1f}" height="{size:.1f}" '
            f'fill="{shade}"/>'
        )
    parts += [_line(_LEFT, bottom, right, _OVER, _INK), _frame()]
    if np.isfinite(limit_m):
        parts += [
            _line(_LEFT, y_px(limit_m), right, y_px(limit_m), _OFF),
            _line(x_px(limit_m), _OVER, x_px(limit_m), bottom, _OFF),
        ]
    for decade in (d for d in _DECADES if d <= highest):
        parts += [_text(x_px(decade), bottom + 15, f"{decade:g}"), _text(_LEFT - 6, y_px(decade) + 4, f"{decade:g}", "end")]
    parts += [
        _text(_LEFT + _SIDE / 2, bottom + 33, "error, m"),
        f'<text x="13" y="{_OVER + _SIDE / 2:.1f}" fill="{_INK}" font-size="11" font-family="sans-serif" text-anchor="middle" '
        f'transform="rotate(-90 13 {_OVER + _SIDE / 2:.1f})">protection level, m</text>',
        _text(_LEFT, 15, title, "start"),
        *_counts(error, level, limit_m, x_px(limit_m), y_px(limit_m)),
    ]
    size_px = f"{right + 24:.0f}", f"{bottom + _UNDER:.0f}"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {" ".join(size_px)}" width="{size_px[0]}" height="{size_px[1]}">'
        + "".join(parts)
        + "</svg>"
    )


def _counts(error: Array, level: Array, limit_m: float, x: float, y: float) -> list[str]:
    r = regions(error, level, limit_m, ())
    right, bottom = _LEFT + _SIDE, _OVER + _SIDE
    if not np.isfinite(limit_m):
        return [
            _text(_LEFT + 6, _OVER + 14, f"nominal {r.nominal}", "start"),
            _text(right - 6, bottom - 8, f"misleading {r.misleading}", "end"),
        ]
    return [
        _text(_LEFT + 6, _OVER + 14, f"unavailable {r.unavailable}", "start"),
        _text(_LEFT + 6, y + 14, f"nominal {r.nominal}", "start"),
        _text(x - 6, bottom - 8, f"misleading {r.misleading}", "end"),
        _text(x + 6, bottom - 8, f"hazardous {r.hazardous}", "start"),
    ]


def _polygon(points: list[tuple[float, float]], colour: str, opacity: float) -> str:
    return f'<polygon points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in points)}" fill="{colour}" fill-opacity="{opacity}"/>'


def _line(x0: float, y0: float, x1: float, y1: float, colour: str) -> str:
    return f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" stroke="{colour}" stroke-width="1.2"/>'


def _frame() -> str:
    return f'<rect x="{_LEFT}" y="{_OVER}" width="{_SIDE}" height="{_SIDE}" fill="none" stroke="{_INK}"/>'


def _text(x: float, y: float, words: str, anchor: str = "middle") -> str:
    style = f'fill="{_INK}" font-size="11" font-family="sans-serif" text-anchor="{anchor}" {_HALO}'
    return f'<text x="{x:.1f}" y="{y:.1f}" {style}>{words}</text>'
