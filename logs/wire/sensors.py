"""The optional sensors on the wire: topic and ROS 2 type of each, and what of the type's fields is its reading.

An entry is a line in SensorTopics and one in SENSORS. Values are SI; a vector is turned from the body's FLU axes to FRD and back.
"""

from collections.abc import Callable
from typing import Annotated, Any, Final, NamedTuple, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta

from logs.wire import schemas
from models.messages import Array, Reading

_Topics: TypeAlias = tuple[str, ...]
_Values: TypeAlias = tuple[tuple[float, ...], Array | None]


class SensorTopics(msgspec.Struct, frozen=True):
    """[inputs] of the optional sensors: off until a topic is named."""

    baro: Annotated[_Topics, Meta(description="topics of sensor_msgs/msg/FluidPressure; none: no barometer is used")] = ()


class Sensor(NamedTuple):
    """topic: where importers and simulation write it; values: of a message, with covariance; fields: of a reading's message."""

    topic: str
    schema: str
    values: Callable[[Any], _Values]
    fields: Callable[[Reading], dict[str, Any]]


def _pressure(reading: Reading) -> dict[str, Any]:
    variance = 0.0 if reading.covariance is None else float(reading.covariance[0, 0])
    return {"fluid_pressure": reading.values[0], "variance": variance}


SENSORS: Final = {  # kind -> its message
    "baro": Sensor("/baro", schemas.PRESSURE, lambda m: ((m.fluid_pressure,), np.array([[m.variance]])), _pressure),
}
