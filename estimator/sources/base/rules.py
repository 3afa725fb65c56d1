"""How the readings of a source are judged, as data.

gate         nu^T S^-1 nu < chi2(gate_probability), over all components at once
false_share  of the readings are false, uniform within the plausible
probation    readings of a returning source pass the gate before it is fused with another position
hold_s       a source is not used after a failed gate or drifting innovations; 0: never held off
spacing_s    of readings closer than this one is fused
timeout_s    without a reading the source has stopped
"""

from typing import Final

import msgspec


class Rules(msgspec.Struct, frozen=True):
    """See above."""

    false_share: float = 0.05
    probation: int = 0
    hold_s: float = 0.0
    spacing_s: float = 0.0
    timeout_s: float = 5.0
    gate_probability: float = 0.9999


RULES: Final = {
    "pose": Rules(),
    "gnss": Rules(false_share=0.01, probation=10, hold_s=10.0),
    "odometry": Rules(false_share=0.01, probation=4),
    "velocity_body": Rules(false_share=0.01, hold_s=5.0, spacing_s=0.1),
    "airspeed": Rules(false_share=0.01, hold_s=30.0, spacing_s=0.2),
    "drag": Rules(hold_s=30.0),
    "rest": Rules(spacing_s=0.9),
    "baro": Rules(false_share=0.01, spacing_s=1.0),
    "range": Rules(false_share=0.02, spacing_s=0.2),
    "beacon": Rules(false_share=0.05, hold_s=5.0, spacing_s=0.2),
    "heading": Rules(false_share=0.01, spacing_s=0.2),
    "magnetometer": Rules(false_share=0.01, spacing_s=0.5),
    "imu": Rules(),
}
