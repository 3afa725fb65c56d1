"""Cameras in a scenario (vision.synthetic draws)."""

from typing import Annotated, Literal

import msgspec

from models.sim.ranges import Interval, NotNegative, Positive, Rate, Share, ascending

Pixels = Annotated[int, msgspec.Meta(ge=64, le=4096)]


class Village(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The world, and the map's errors.

    area_m: side, spacing_m: between buildings; clear_m: around take-off; painted: strong colours; unmapped, gone: shares.
    """

    layout: Literal["village", "grid", "lookalikes"] = "village"
    area_m: Positive = 300.0
    spacing_m: Positive = 25.0
    clear_m: NotNegative = 8.0
    painted: Share = 0.5
    unmapped: Share = 0.2
    gone: Share = 0.05
    sigma_m: NotNegative = 0.3
    height_sigma_m: NotNegative = 0.3
    outline_sigma_m: NotNegative = 0.1
    seed: int = 1


class Cameras(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A stereo rig that looks down by -pitch_deg (-90: straight down); one_camera: left only.

    sees: colour, grey (8 bit), thermal (16 bit, night); haze_per_m: extinction; light_swing: share; jpeg_quality: 0: none;
    delay_s: exposure to arrival; outages_s: no images; dark_s: lens covered.
    """

    rate_hz: Rate = 2.0
    one_camera: bool = False
    sees: Literal["colour", "grey", "thermal"] = "colour"
    width: Pixels = 640
    height: Pixels = 480
    focal_px: Positive = 600.0
    baseline_m: Positive = 0.3
    pitch_deg: Annotated[float, msgspec.Meta(ge=-90.0, le=0.0)] = -90.0
    exposure_s: NotNegative = 0.002
    haze_per_m: NotNegative = 3e-4
    light_swing: Share = 0.15
    jpeg_quality: Annotated[int, msgspec.Meta(ge=0, le=100)] = 92
    delay_s: NotNegative = 0.06
    outages_s: tuple[Interval, ...] = ()
    dark_s: tuple[Interval, ...] = ()
    odometry: bool = False
    world: Village = msgspec.field(default_factory=Village)

    def __post_init__(self) -> None:
        ascending("outages_s, dark_s", *self.outages_s, *self.dark_s)
