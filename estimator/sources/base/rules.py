"""The rules by which a source is judged: keys of its section in the configuration."""

from typing import Annotated

import msgspec
from msgspec import Meta


class GateRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How a source is judged."""

    gate_probability: Annotated[
        float, Meta(gt=0.5, lt=1, description="share of good measurements that pass the chi-square gate")
    ] = 0.9999
    timeout_s: Annotated[float, Meta(ge=1e-3, le=1e6, description="s: silent for longer, the source has stopped")] = 5.0
    false_share: Annotated[float, Meta(ge=1e-9, lt=1, description="share of measurements expected to be false")] = 0.05
    probation: Annotated[
        int,
        Meta(
            ge=0,
            le=1_000_000,
            description="measurements that must pass before a (returning) source is fused together with another one",
        ),
    ] = 0
    hold_s: Annotated[float, Meta(ge=0, le=1e6, description="s: how long a rejected source is held off; 0: never")] = 0.0


class SourceRules(GateRules, frozen=True, forbid_unknown_fields=True):
    """How a source is judged whose readings may be false for a while, and so compete as hypotheses."""

    spacing_s: Annotated[
        float, Meta(ge=0, le=3600, description="s: errors of readings closer than this are the same; only one of them is fused")
    ] = 0.0
