"""JSON-ready drawings of the page: time plots, bars, state strips, map."""

from typing import Literal

import msgspec
import numpy as np

from logs.report.buckets import Buckets
from models.messages import Array

Colour = Literal["black", "blue", "green", "vermillion", "sky", "orange", "purple", "grey"]
Shape = Literal["dot", "diamond", "cross", "plus", "triangle", "square"]
Numbers = list[float | None]


class Line(msgspec.Struct, frozen=True, tag="line"):
    """Extremes per time span; turn: an angle's period, or 0."""

    name: str
    colour: Colour
    start: float
    step: float
    low: Numbers
    high: Numbers
    turn: float = 0.0


class Band(msgspec.Struct, frozen=True, tag="band"):
    """An area from low to high per span."""

    name: str
    colour: Colour
    start: float
    step: float
    low: Numbers
    high: Numbers


class Points(msgspec.Struct, frozen=True, tag="points"):
    """Single events; text: tooltip."""

    name: str
    colour: Colour
    shape: Literal["dot", "cross", "tick", "top"]  # tick: along the lower edge, top: along the upper one
    t: Numbers
    y: Numbers
    text: list[str]


class Level(msgspec.Struct, frozen=True):
    """A labelled horizontal line."""

    y: float
    name: str


class TimeChart(msgspec.Struct, frozen=True, tag="time"):
    """A plot over seconds since the first estimate; asinh: linear within +-linear."""

    title: str
    unit: str
    parts: list[Line | Band | Points]
    levels: list[Level] = []
    scale: Literal["linear", "log", "asinh"] = "linear"
    linear: float = 1.0
    height: int = 190


class Stay(msgspec.Struct, frozen=True):
    """A state from start to end."""

    start: float
    end: float
    colour: Colour
    text: str
    name: str  # of the colour, in the legend


class StripChart(msgspec.Struct, frozen=True, tag="strip"):
    """States over time, one row each."""

    title: str
    rows: dict[str, list[Stay]]


class BarChart(msgspec.Struct, frozen=True, tag="bars"):
    """Counts between edges, both logarithmic."""

    title: str
    unit: str
    edges: Numbers
    counts: list[int]
    colour: Colour = "blue"


class Path(msgspec.Struct, frozen=True):
    """A line on the map."""

    name: str
    colour: Colour
    x: Numbers
    y: Numbers
    t: Numbers
    dashed: bool = False  # what the estimate is compared with


class Ellipse(msgspec.Struct, frozen=True):
    """Semi-axes a, b; a turned by turn_deg from east to north."""

    x: float
    y: float
    a: float
    b: float
    turn_deg: float
    text: str


class Place(msgspec.Struct, frozen=True):
    """A landmark's outline."""

    name: str
    used: bool
    x: Numbers
    y: Numbers


class Marks(msgspec.Struct, frozen=True):
    """Points on the map."""

    name: str
    colour: Colour
    shape: Shape
    x: Numbers
    y: Numbers
    text: list[str]


class MapChart(msgspec.Struct, frozen=True, tag="map"):
    """From above, metres; box: west, south, east, north of the initial view."""

    title: str
    paths: list[Path]
    ellipses: list[Ellipse]
    places: list[Place]
    marks: list[Marks]
    box: tuple[float, float, float, float]


Chart = TimeChart | StripChart | BarChart | MapChart


class Span(msgspec.Struct, frozen=True):
    """A shade behind every plot over time."""

    start: float
    end: float
    name: str


class Drawing(msgspec.Struct, frozen=True):
    """charts by name, shades, common initial time."""

    charts: dict[str, Chart]
    spans: list[Span]
    begin: float
    end: float


def short(values: Array, digits: int = 5) -> Numbers:
    """Numbers of so many digits, None for none."""
    return [float(f"{x:.{digits}g}") if np.isfinite(x) else None for x in np.asarray(values, float).tolist()]


def line(name: str, colour: Colour, of: Buckets, column: int, start_ns: int, turn: float = 0.0) -> Line:
    """One signal of some."""
    low, high = short(of.low[:, column]), short(of.high[:, column])
    return Line(name, colour, _start(of, start_ns), of.step_ns * 1e-9, low, high, turn)


def band(name: str, colour: Colour, of: Buckets, column: int, half: int | Array, start_ns: int) -> Band:
    """A band of half a width (column or array) about a signal."""
    width = of.high[:, half] if isinstance(half, int) else half
    low, high = short(of.low[:, column] - width), short(of.high[:, column] + width)
    return Band(name, colour, _start(of, start_ns), of.step_ns * 1e-9, low, high)


def _start(of: Buckets, start_ns: int) -> float:
    return (of.start_ns + of.step_ns // 2 - start_ns) * 1e-9
