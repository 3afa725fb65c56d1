"""The configuration of integrity: alert limits, and how often which fault is expected (docs/integrity.md has the reasons)."""

from typing import Annotated, TypeAlias

import msgspec
from msgspec import Meta

_Limit: TypeAlias = Annotated[float, Meta(ge=0.1, le=1e6)]
_Rate: TypeAlias = Annotated[float, Meta(ge=0, le=1e3)]


class IntegrityConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[integrity]: a bound on the error with a stated risk, and the alert when it exceeds a limit."""

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
            description="s: within it an alert is due; five protection levels come in it; without a limit half of one",
        ),
    ] = 1.0
    correlation_s: Annotated[
        float, Meta(ge=0.1, le=3600, description="s: an hour holds 3600 / this independent errors of position")
    ] = 10.0
    core_scale: Annotated[float, Meta(ge=1, le=10, description="real errors / reported sigma, of most of them")] = 1.2
    tail_scale: Annotated[float, Meta(ge=1, le=100, description="the same of the others, the tail")] = 2.0
    tail_share: Annotated[float, Meta(ge=0, le=0.5, description="share of the tail")] = 0.02
    gnss_fault_per_hour: Annotated[_Rate, Meta(description="1/h: a GNSS receiver is wrong for long, by any distance")] = 1e-4
    fix_fault_per_hour: Annotated[_Rate, Meta(description="1/h: all fixes are wrong, by more than the kinds below")] = 1e-6
    landmark_fault_per_hour: Annotated[_Rate, Meta(description="1/h: one false fix that passes the gate")] = 1.0
    map_fault_per_hour: Annotated[_Rate, Meta(description="1/h: the map is shifted")] = 1e-4
    map_shift_m: Annotated[float, Meta(ge=0, le=1e4, description="m: by this much at most")] = 3.0
    map_scale_percent: Annotated[
        float, Meta(ge=0, le=100, description="%: the map's distances from the origin are wrong, by this much at most")
    ] = 0.1
    rig_fault_per_hour: Annotated[_Rate, Meta(description="1/h: the cameras have turned on their mount")] = 1e-4
    rig_turn_deg: Annotated[float, Meta(ge=0, le=90, description="deg: by this much at most, landmarks 50 m away")] = 1.0
    timing_fault_per_hour: Annotated[_Rate, Meta(description="1/h: the stamps of a source are wrong")] = 1e-4
    timing_s: Annotated[float, Meta(ge=0, le=60, description="s: by this much at most")] = 0.1
    imu_fault_per_hour: Annotated[_Rate, Meta(description="1/h: the IMU's acceleration is wrong")] = 1e-4
    imu_fault_m_s2: Annotated[float, Meta(ge=0, le=100, description="m/s^2: by this much at most")] = 0.3
    exclude_rejected: Annotated[
        bool,
        Meta(description="a source that the filter rejects is not compared with; false: the bound covers both"),
    ] = False
