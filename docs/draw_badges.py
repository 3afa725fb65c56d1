"""Draws docs/images/badges.svg, what pyproject.toml says of the project:  python -m docs.draw_badges"""

import tomllib
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).parents[1]
OUT: Final = ROOT / "docs" / "images" / "badges.svg"
_GREY, _BLUE = "#444c56", "#1f6f8b"
_CHARACTER, _SIDE, _GAP, _HEIGHT = 6.6, 7.0, 6.0, 20.0


def facts(project: dict[str, Any]) -> list[tuple[str, str]]:
    """What is true: left and right half of each badge."""
    tool = project["tool"]
    types = "mypy --strict" if tool["mypy"]["strict"] else "mypy"
    python = project["project"]["requires-python"].removeprefix(">=")
    return [
        ("licence", project["project"]["license"]),
        ("python", f"{python} and newer"),
        ("types", types),
        ("checked by", ", ".join(name for name in ("ruff", "pytest") if name in tool)),
    ]


def drawn(project: dict[str, Any]) -> str:
    """The badges as one SVG; text has a fixed length, so that any font fits."""
    parts: list[str] = []
    x = 0.0
    for halves in facts(project):
        for words, colour in zip(halves, (_GREY, _BLUE), strict=True):
            wide = _CHARACTER * len(words)
            parts.append(f'<rect x="{x:.1f}" width="{wide + 2 * _SIDE:.1f}" height="{_HEIGHT:.0f}" fill="{colour}"/>')
            parts.append(
                f'<text x="{x + _SIDE:.1f}" y="14" textLength="{wide:.1f}" lengthAdjust="spacingAndGlyphs">{words}</text>'
            )
            x += wide + 2 * _SIDE
        x += _GAP
    said = "; ".join(" ".join(halves) for halves in facts(project))
    size = f'width="{x - _GAP:.0f}" height="{_HEIGHT:.0f}"'
    style = 'fill="#fff" font-family="DejaVu Sans,Verdana,sans-serif" font-size="11"'
    body = "\n".join(parts)
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img"><title>{said}</title>\n<g {style}>\n{body}\n</g></svg>\n'


if __name__ == "__main__":
    OUT.write_text(drawn(tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))), encoding="utf-8")
