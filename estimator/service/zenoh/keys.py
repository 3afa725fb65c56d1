"""Topics as keys of Zenoh.

rmw_zenoh   <domain>/<topic>/<pkg>::msg::dds_::<Type>_/RIHS01_<hash>      attachment: sequence, time sent, 16, id of the sender
ros2dds     <topic>                                                       no attachment
"""

import struct
from typing import Final

_ATTACHMENT: Final = struct.Struct("<qqB16s")
_GID_BYTES: Final = 16
_DOMAIN_DIGITS: Final = 3
_VOLATILE: Final = ":2:,10:,:,:,,"


def dds_type(schema: str) -> str:
    """sensor_msgs/msg/Imu -> sensor_msgs::msg::dds_::Imu_."""
    package, _, name = schema.split("/")
    return f"{package}::msg::dds_::{name}_"


def rmw_key(domain: int, topic: str, schema: str, type_hash: str = "*") -> str:
    """Key of a topic; type_hash "*": any release."""
    return f"{domain}/{topic.strip('/')}/{dds_type(schema)}/{type_hash}"


def plain_key(topic: str) -> str:
    """The key of a topic for the bridge."""
    return topic.strip("/")


def attachment(sequence: int, sent_ns: int, gid: bytes) -> bytes:
    """Attachment of rmw_zenoh samples; sequence counts from 1."""
    return _ATTACHMENT.pack(sequence, sent_ns, _GID_BYTES, gid)


def node_token(domain: int, zid: str, node: str) -> str:
    """Liveliness token that makes the node visible (`ros2 node list`)."""
    return f"@ros2_lv/{domain}/{zid}/0/0/NN/%/%/{node}"


def publisher_token(domain: int, zid: str, node: str, entity: int, topic: str, schema: str, type_hash: str) -> str:
    """Liveliness token that makes a publisher visible (`ros2 topic list`)."""
    name = "%" + topic.strip("/").replace("/", "%")
    return f"@ros2_lv/{domain}/{zid}/0/{entity}/MP/%/%/{node}/{name}/{dds_type(schema)}/{type_hash}/{_VOLATILE}"


def subscriber_token(domain: int, zid: str, node: str, entity: int, topic: str, schema: str, type_hash: str) -> str:
    """Liveliness token that makes a subscriber visible (`ros2 topic info`)."""
    return publisher_token(domain, zid, node, entity, topic, schema, type_hash).replace("/MP/", "/MS/", 1)


def publisher_tokens(topic: str) -> str:
    """Tokens of a topic's publishers on any domain."""
    return f"@ros2_lv/*/*/*/*/MP/*/*/*/%{topic.strip('/').replace('/', '%')}/**"


def every_publisher(domain: int) -> str:
    """Tokens of all publishers on a domain."""
    return f"@ros2_lv/{domain}/*/*/*/MP/**"


def published_of(token: str) -> tuple[str, str] | None:
    """Topic and schema of a publisher's token; None: invalid."""
    name, kind = [*token.split("/"), *[""] * 11][9:11]
    package, _, kind = kind.removesuffix("_").partition("::msg::dds_::")
    return (name.replace("%", "/"), f"{package}/msg/{kind}") if name and kind else None


def domain_of(token: str) -> int:
    """Domain of a publisher's token; -1: invalid."""
    domain = token.split("/")[1]
    return int(domain) if domain.isdecimal() and len(domain) <= _DOMAIN_DIGITS else -1


def bridge_token(zid: str, topic: str, schema: str, type_hash: str) -> str:
    """Token for the bridge to announce a publisher."""
    name, kind = topic.strip("/").replace("/", "§"), schema.replace("/", "§")
    return f"@/{zid}/@ros2_lv/MP/{name}/{kind}/:1:0:0,10:typehash={type_hash};"
