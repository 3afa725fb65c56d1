"""Draws docs/images/integrity_faults.svg, the fault tree with the rates of the defaults:  python -m docs.draw_integrity"""

from pathlib import Path
from typing import Final

from estimator.integrity.config import IntegrityConfig

OUT: Final = Path(__file__).parent / "images" / "integrity_faults.svg"
_WIDE, _HIGH, _GAP = 176.0, 118.0, 12.0  # px: a leaf, and what lies between two
_COLUMNS: Final = 5
_TOP, _LINE = 92.0, 16.0
_BOUNDED, _CHECKED, _OPEN = "#dbe9f4", "#e4efdc", "#f6ddd3"


def leaves(c: IntegrityConfig) -> list[tuple[str, list[str]]]:
    """Colour and lines of each leaf."""
    return [
        (_BOUNDED, ["nominal errors", f"{3600.0 / c.correlation_s:.0f} an hour", "heavy tail on the", "reported covariance"]),
        (_CHECKED, ["undecided hypothesis", "its weight in the filter", "bound: its position", "and covariance"]),
        (_BOUNDED, ["false fix in the gate", f"{c.landmark_fault_per_hour:g} / h", "bound: 4 sigma"]),
        (
            _BOUNDED,
            ["map shifted", f"{c.map_fault_per_hour:g} / h", f"bound: {c.map_shift_m:g} m,", f"scale {c.map_scale_percent:g} %"],
        ),
        (_BOUNDED, ["cameras turned", f"{c.rig_fault_per_hour:g} / h", f"bound: {c.rig_turn_deg:g} deg at 50 m"]),
        (_BOUNDED, ["stamps wrong", f"{c.timing_fault_per_hour:g} / h, each source", f"bound: speed x {c.timing_s:g} s"]),
        (
            _BOUNDED,
            ["IMU wrong", f"{c.imu_fault_per_hour:g} / h", f"bound: {c.imu_fault_m_s2:g} m/s2", "since the last position"],
        ),
        (
            _CHECKED,
            ["GNSS wrong for long", f"{c.gnss_fault_per_hour:g} / h", "bound: another source,", "or hypothesis without it"],
        ),
        (_CHECKED, ["all fixes wrong", f"{c.fix_fault_per_hour:g} / h", "bound: another source"]),
        (_OPEN, ["no second source", "no bound: no level at", "a risk below the rate"]),
    ]


def drawn(c: IntegrityConfig) -> str:
    """The tree: the top event, an OR gate, and the leaves in two rows."""
    found = leaves(c)
    width = _COLUMNS * _WIDE + (_COLUMNS - 1) * _GAP
    middle, bus = width / 2.0, _TOP - 16.0
    parts = [_box(middle - 190.0, 0.0, 380.0, 44.0, "#ffffff", ["error > protection level, without an alert"])]
    parts += [_line(middle, 44.0, middle, bus), _line(-_GAP / 2.0, bus, width - _WIDE / 2.0, bus)]
    parts.append(f'<circle cx="{middle:.0f}" cy="{bus:.0f}" r="15" fill="#fff" stroke="#444c56"/>')
    parts.append(f'<text x="{middle:.0f}" y="{bus + 4:.0f}" text-anchor="middle" font-weight="bold">OR</text>')
    for k, (colour, lines) in enumerate(found):
        row, column = divmod(k, _COLUMNS)
        x, y = column * (_WIDE + _GAP), _TOP + 14.0 + row * (_HIGH * 0.8 + 26.0)
        if row == 0:
            parts.append(_line(x + _WIDE / 2.0, bus + (15.0 if column == _COLUMNS // 2 else 0.0), x + _WIDE / 2.0, y))
        else:
            beside, level = x - _GAP / 2.0, y + _HIGH * 0.4
            parts += [_line(beside, bus, beside, level), _line(beside, level, x, level)]
        parts.append(_box(x, y, _WIDE, _HIGH * 0.8, colour, lines))
    height = _TOP + 14.0 + 2.0 * _HIGH * 0.8 + 26.0
    notes = ((_BOUNDED, "bounded by covariance or configuration"), (_CHECKED, "bounded by a separation"), (_OPEN, "not bounded"))
    for k, (colour, words) in enumerate(notes):
        x = k * 310.0
        parts.append(f'<rect x="{x:.0f}" y="{height + 14:.0f}" width="14" height="14" fill="{colour}" stroke="#444c56"/>')
        parts.append(f'<text x="{x + 22:.0f}" y="{height + 26:.0f}">{words}</text>')
    size = f'viewBox="-8 -8 {width + 16:.0f} {height + 52:.0f}" width="{width + 16:.0f}"'
    style = 'font-family="DejaVu Sans,Verdana,sans-serif" font-size="12" fill="#1c2126"'
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img"><title>Fault tree</title>\n'
        f'<rect x="-8" y="-8" width="100%" height="100%" fill="#fff"/>\n<g {style}>\n{body}\n</g></svg>\n'
    )


def _box(x: float, y: float, width: float, height: float, colour: str, lines: list[str]) -> str:
    parts = [f'<rect x="{x:.0f}" y="{y:.0f}" width="{width:.0f}" height="{height:.0f}" rx="4" fill="{colour}" stroke="#444c56"/>']
    first = y + height / 2.0 - _LINE * (len(lines) - 1) / 2.0 + 4.0
    for k, words in enumerate(lines):
        weight = ' font-weight="bold"' if k == 0 else ""
        at = f'x="{x + width / 2.0:.0f}" y="{first + k * _LINE:.0f}"'
        parts.append(f'<text {at} text-anchor="middle"{weight}>{words.replace(">", "&gt;")}</text>')
    return "\n".join(parts)


def _line(x0: float, y0: float, x1: float, y1: float) -> str:
    return f'<path d="M{x0:.0f},{y0:.0f}L{x1:.0f},{y1:.0f}" stroke="#444c56" stroke-width="1.2"/>'


if __name__ == "__main__":
    OUT.write_text(drawn(IntegrityConfig()), encoding="utf-8")
