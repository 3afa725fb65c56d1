"""Draws docs/images/architecture.svg, the layers that pyproject.toml has contracts for:  python -m docs.draw_architecture"""

import tomllib
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).parents[1]
OUT: Final = ROOT / "docs" / "images" / "architecture.svg"
_BAND, _GAP, _TITLE, _PAD = 24.0, 4.0, 28.0, 10.0  # px
_LINE, _LETTER = 16.0, 7.0  # px: from line to line, and a letter of the text
_WIDE, _SPACE = 284.0, 34.0  # px: a column, and what lies between two
_FILL: Final = {"estimator": "#dbe9f4", "calib": "#e4efdc", "vision": "#fbe9d0", "logs": "#efe3f3", "models": "#ececec"}


def layers(contracts: list[dict[str, Any]], package: str) -> list[list[str]]:
    """The layers inside a package from the top down, each a list of modules; a folder ends in a slash."""
    (contract,) = (c for c in contracts if c.get("containers") == [package])
    rows: list[list[str]] = []
    for layer in contract["layers"]:
        names = [name.strip(" ()") for name in layer.replace("|", ":").split(":")]
        folder = ROOT / package
        row = [f"{n}/" if (folder / n).is_dir() else n for n in names if (folder / n).is_dir() or (folder / f"{n}.py").exists()]
        rows += [row] if row else []
    return rows


def drawn(project: dict[str, Any]) -> str:
    """The five packages as one SVG: who imports stands above or to the left."""
    contracts = project["tool"]["importlinter"]["contracts"]
    right, far = _WIDE + _SPACE, 2.0 * (_WIDE + _SPACE)
    wide = {package: far + _WIDE if package == "models" else _WIDE for package in _FILL}
    rows = {package: [_lines(row, wide[package]) for row in layers(contracts, package)] for package in _FILL}
    tall = {package: _TITLE + sum(_height(row) + _GAP for row in r) + _PAD for package, r in rows.items()}
    upper = max(tall["estimator"], tall["calib"] + _SPACE + tall["vision"])
    width = far + _WIDE
    place = {  # x, y, width, height
        "estimator": (0.0, 0.0, _WIDE, upper),
        "calib": (right, 0.0, _WIDE, tall["calib"]),
        "vision": (right, tall["calib"] + _SPACE, _WIDE, upper - tall["calib"] - _SPACE),
        "logs": (far, 0.0, _WIDE, upper),
        "models": (0.0, upper + _SPACE, width, tall["models"]),
    }
    parts = [_box(package, place[package], rows[package]) for package in _FILL]
    for y, x0, x1 in (
        (tall["calib"] / 2.0, _WIDE, right),
        (place["vision"][1] + tall["vision"] / 2.0, _WIDE, right),
    ):
        parts.append(_arrow(x0, y, x1, y))
    over = tall["calib"] + _SPACE / 2.0  # estimator -> logs passes between calib and vision
    parts.append(_arrow(_WIDE, over, far, over))
    parts.append(_arrow(right + 0.75 * _WIDE, tall["calib"], right + 0.75 * _WIDE, place["vision"][1]))
    parts += [_arrow(x + _WIDE / 2.0, upper, x + _WIDE / 2.0, upper + _SPACE) for x in (0.0, right, far)]
    head = '<marker id="head" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
    head += '<path d="M0,0L8,4L0,8z" fill="#444c56"/></marker>'
    size = f'viewBox="-8 -8 {width + 16:.0f} {upper + _SPACE + tall["models"] + 16:.0f}" width="{width + 16:.0f}"'
    style = 'font-family="DejaVu Sans,Verdana,sans-serif" font-size="12" fill="#1c2126"'
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img"><title>Layers of landfix</title>\n<defs>{head}</defs>\n'
        f'<rect x="-8" y="-8" width="100%" height="100%" fill="#fff"/>\n<g {style}>\n{body}\n</g></svg>\n'
    )


def _lines(names: list[str], width: float) -> list[str]:
    """The names of a layer, in as many lines as a box of this width needs."""
    lines, most = [names[0]], (width - 4.0 * _PAD) / _LETTER
    for name in names[1:]:
        if len(lines[-1]) + len(name) + 3 > most:
            lines.append(name)
        else:
            lines[-1] += f" · {name}"
    return lines


def _height(lines: list[str]) -> float:
    return _BAND + (len(lines) - 1) * _LINE


def _box(package: str, place: tuple[float, float, float, float], rows: list[list[str]]) -> str:
    x, y, width, height = place
    parts = [
        f'<rect x="{x:.0f}" y="{y:.0f}" width="{width:.0f}" height="{height:.0f}" rx="4" '
        f'fill="{_FILL[package]}" stroke="#444c56"/>',
        f'<text x="{x + _PAD:.0f}" y="{y + 19:.0f}" font-weight="bold">{package}/</text>',
    ]
    top = y + _TITLE
    for lines in rows:
        parts.append(
            f'<rect x="{x + _PAD:.0f}" y="{top:.0f}" width="{width - 2 * _PAD:.0f}" '
            f'height="{_height(lines):.0f}" rx="3" fill="#fff"/>'
        )
        parts += [
            f'<text x="{x + width / 2:.0f}" y="{top + 16 + k * _LINE:.0f}" text-anchor="middle">{line}</text>'
            for k, line in enumerate(lines)
        ]
        top += _height(lines) + _GAP
    return "\n".join(parts)


def _arrow(x0: float, y0: float, x1: float, y1: float) -> str:
    return f'<path d="M{x0:.0f},{y0:.0f}L{x1:.0f},{y1:.0f}" stroke="#444c56" stroke-width="1.5" marker-end="url(#head)"/>'


if __name__ == "__main__":
    OUT.write_text(drawn(tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))), encoding="utf-8")
