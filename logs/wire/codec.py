"""Wire <-> records: CDR in ENU / FLU outside, models.messages in NED / FRD inside.

Other types become Unusable; strange values pass.
"""

from logs.wire.axes import ImuMounting
from logs.wire.decoding import (
    CHECKPOINT_TOPIC,
    TICK_TOPIC,
    Decoder,
    Odometry,
    Topics,
    decode_aid_status,
    decode_diagnostics,
    decode_odometry,
    decode_odometry_request,
    decode_vision_request,
    is_own_transform,
)
from logs.wire.encoding import (
    ODOMETRY_REQUEST_TOPIC,
    VISION_REQUEST_TOPIC,
    Encoded,
    encode,
    encode_input,
    encode_slow,
    encode_truth,
)
from logs.wire.integrity import INTEGRITY_TOPIC, decode_integrity
from logs.wire.schemas import SCHEMAS, type_hash

__all__ = [
    "CHECKPOINT_TOPIC",
    "INTEGRITY_TOPIC",
    "ODOMETRY_REQUEST_TOPIC",
    "SCHEMAS",
    "TICK_TOPIC",
    "VISION_REQUEST_TOPIC",
    "Decoder",
    "Encoded",
    "ImuMounting",
    "Odometry",
    "Topics",
    "decode_aid_status",
    "decode_diagnostics",
    "decode_integrity",
    "decode_odometry",
    "decode_odometry_request",
    "decode_vision_request",
    "encode",
    "encode_input",
    "encode_slow",
    "encode_truth",
    "is_own_transform",
    "type_hash",
]
