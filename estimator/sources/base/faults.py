"""Faults as data.

    source         fault                                 onset                 lasts       size
    any            one false reading                     false_share           -           uniform within what is plausible
    pose, range..  the same false reading again          with the false one    LASTS_S     the last one
    fixes, GNSS    noisier than they report: jammed      when it is seen       12 readings mismatch/scatter.py measures it
    any            held: equal to the bit in motion      when it is seen       -           held.py; the reading is missing
    IMU            wrong in an unknown way               a fix nobody predicts until fixes show it right; unknown motion
    GNSS           misled for long                       1 - [gnss] trust      to the end  any
    map            elsewhere than the receiver           MAP_ELSEWHERE         to the end  MAP_ELSEWHERE_M
    map, rig, stamps, IMU, fixes: rates an hour, below, for the protection levels ([integrity] replaces them)

Rates an hour: engineering judgement (docs/integrity.md).
"""

from typing import Final

RECENT_NS: Final = 10_000_000_000  # a source that gave something since then counts; agreement for so long is enough
LONG_NS: Final = 60_000_000_000  # sums and runs of readings reach back so far
RECENT_S: Final = RECENT_NS / 1e9
LONG_S: Final = LONG_NS / 1e9

LASTS_S: Final = {"gnss_position": 10.0, "gnss_velocity": 10.0, "range": 10.0, "baro": 60.0}
OTHERS_LAST_S: Final = 1.5  # pose fixes and all others

MAP_ELSEWHERE: Final = 0.05  # share of the conflicts with a receiver in which the map stands in the wrong place
MAP_ELSEWHERE_M: Final = 20.0  # by so much: geoid, datum, origin

GNSS_PER_HOUR: Final = 1e-4  # wrong for long, by any distance
FIXES_PER_HOUR: Final = 1e-6  # all of them wrong, by more than the kinds below
FALSE_FIX_PER_HOUR: Final = 1.0  # inside the gate
MAP_PER_HOUR, MAP_M, MAP_PERCENT = 1e-4, 3.0, 0.1  # shifted; its scale
RIG_PER_HOUR, RIG_DEG = 1e-4, 1.0  # turned on its mount
STAMPS_PER_HOUR, STAMPS_S = 1e-4, 0.1
IMU_PER_HOUR, IMU_M_S2 = 1e-4, 0.3


def lasts_s(kind: str) -> float:
    """Mean duration of a repeated fault of such a source."""
    return LASTS_S.get(kind, OTHERS_LAST_S)
