"""Configuration of integrity: alert limits and fault rates (reasons: docs/integrity.md)."""

from typing import Annotated, TypeAlias

import msgspec
from msgspec import Meta

from estimator.sources.base import faults

_Limit: TypeAlias = Annotated[float, Meta(ge=0.1, le=1e6)]
_Rate: TypeAlias = Annotated[float, Meta(ge=0, le=1e3)]


class IntegrityConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[integrity]: a bound on the error at a stated risk, and the alert."""

    hal_m: Annotated[_Limit | None, Meta(description="m: horizontal alert limit; none: nothing is judged")] = None
    val_m: Annotated[_Limit | None, Meta(description="m: vertical alert limit; none: heights are not judged")] = None
    risk_per_hour: Annotated[
        float, Meta(ge=1e-9, le=0.1, description="1/h: how often the error may exceed the protection level without an alert")
    ] = 1e-5
    time_to_alert_s: Annotated[
        float,
        Meta(
            ge=0.1,
            le=60,
            description="s: within it an alert is due; two protection levels come in it; without a limit half of one",
        ),
    ] = 1.0
    correlation_s: Annotated[
        float, Meta(ge=0.1, le=3600, description="s: an hour holds 3600 / this independent errors of position")
    ] = 10.0
    core_scale: Annotated[float, Meta(ge=1, le=10, description="real errors / reported sigma, of most of them")] = 1.2
    tail_scale: Annotated[float, Meta(ge=1, le=100, description="the same of the others, the tail")] = 2.0
    tail_share: Annotated[float, Meta(ge=0, le=0.5, description="share of the tail")] = 0.02
    gnss_fault_per_hour: Annotated[_Rate, Meta(description="1/h: a GNSS receiver is wrong for long, by any distance")] = (
        faults.GNSS_PER_HOUR
    )
    fix_fault_per_hour: Annotated[_Rate, Meta(description="1/h: all fixes are wrong, by more than the kinds below")] = (
        faults.FIXES_PER_HOUR
    )
    landmark_fault_per_hour: Annotated[_Rate, Meta(description="1/h: one false fix that passes the gate")] = (
        faults.FALSE_FIX_PER_HOUR
    )
    map_fault_per_hour: Annotated[_Rate, Meta(description="1/h: the map is shifted")] = faults.MAP_PER_HOUR
    map_shift_m: Annotated[float, Meta(ge=0, le=1e4, description="m: by this much at most")] = faults.MAP_M
    map_scale_percent: Annotated[
        float, Meta(ge=0, le=100, description="%: the map's distances from the origin are wrong, by this much at most")
    ] = faults.MAP_PERCENT
    rig_fault_per_hour: Annotated[_Rate, Meta(description="1/h: the cameras have turned on their mount")] = faults.RIG_PER_HOUR
    rig_turn_deg: Annotated[float, Meta(ge=0, le=90, description="deg: by this much at most, landmarks 50 m away")] = (
        faults.RIG_DEG
    )
    timing_fault_per_hour: Annotated[_Rate, Meta(description="1/h: the stamps of a source are wrong")] = faults.STAMPS_PER_HOUR
    timing_s: Annotated[float, Meta(ge=0, le=60, description="s: by this much at most")] = faults.STAMPS_S
    imu_fault_per_hour: Annotated[_Rate, Meta(description="1/h: the IMU's acceleration is wrong")] = faults.IMU_PER_HOUR
    imu_fault_m_s2: Annotated[float, Meta(ge=0, le=100, description="m/s^2: by this much at most")] = faults.IMU_M_S2
    exclude_rejected: Annotated[
        bool,
        Meta(description="a source that the filter rejects is not compared with; false: the bound covers both"),
    ] = False
