"""The Zenoh session: loopback only by default; beyond, peers must authenticate."""

import ipaddress
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import msgspec
from msgspec import Meta

from estimator.service.base.loopback import is_loopback
from estimator.service.base.secret_file import check_secret, read_secret
from estimator.strict_toml import ConfigError

if TYPE_CHECKING:
    import zenoh

_WITH_CERTIFICATE = ("tls", "quic")
_HARMLESS = frozenset({"iface", "bind", "dscp", "so_sndbuf", "so_rcvbuf"})  # behind '#'; others can undo the certificates
_LOCAL_PROTOCOLS = ("unixsock-stream", "unixpipe")
_WITH_PORT, _WITHOUT_PORT = ("tcp", "udp", "tls", "quic", "ws"), (*_LOCAL_PROTOCOLS, "serial", "vsock")
_LARGEST_PORT = 65535
_CLOSED = {"scouting/multicast/enabled": False, "scouting/gossip/enabled": False}
_QUEUE = "transport/link/tx/queue"
_PATIENT, _MOST_BATCHES = ("real_time", "data"), 16


class SecurityConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[zenoh.security]: who may come and do what; files relative to the configuration."""

    users_file: Annotated[str | None, Meta(description="file of user:password lines; whoever is not in it is refused")] = None
    user: Annotated[str | None, Meta(description="who we are to others")] = None
    password_file: Annotated[str | None, Meta(description="file with our password")] = None
    ca_file: Annotated[str | None, Meta(description="certificate of the authority that signs everybody's certificate")] = None
    certificate_file: Annotated[str | None, Meta(description="our certificate; others must show theirs (mutual TLS)")] = None
    key_file: Annotated[str | None, Meta(description="key of our certificate")] = None
    names_are: Annotated[
        Literal["users", "certificates", "interfaces"],
        Meta(description="what feeders and listeners names: users, common names of certificates, or network interfaces"),
    ] = "users"
    feeders: Annotated[tuple[str, ...], Meta(description="names that may feed the inputs")] = ()
    listeners: Annotated[tuple[str, ...], Meta(description="names that may read what we publish, and ask the queryables")] = ()
    insecure: Annotated[bool, Meta(description="whether endpoints beyond loopback may be open to everybody in reach")] = False


class ZenohConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[zenoh]: the bus."""

    enabled: Annotated[bool, Meta(description="whether there is Zenoh at all")] = True
    mode: Annotated[Literal["peer", "client", "router"], Meta(description="role in the Zenoh network")] = "peer"
    listen: Annotated[tuple[str, ...], Meta(description="endpoints to listen on, such as tcp/127.0.0.1:7447; []: none")] = (
        "tcp/127.0.0.1:7447",
    )
    connect: Annotated[tuple[str, ...], Meta(description="endpoints of routers or peers, such as that of rmw_zenohd")] = ()
    domain: Annotated[int, Meta(ge=0, le=232, description="ROS_DOMAIN_ID")] = 0
    node: Annotated[str, Meta(pattern="^[a-z][a-z0-9_]*$", description="our name in the ROS graph")] = "landfix"
    rmw: Annotated[bool, Meta(description="keys of rmw_zenoh: ROS 2 Jazzy and newer")] = True
    ros2dds: Annotated[bool, Meta(description="plain keys in addition, for zenoh-bridge-ros2dds")] = False
    diagnostics: Annotated[bool, Meta(description="health and status on /diagnostics too, for ROS's monitors")] = False
    largest_kb: Annotated[int, Meta(ge=1, le=1_000_000, description="kB: a larger message, images apart, is refused")] = 64
    largest_image_mb: Annotated[int, Meta(ge=1, le=200, description="MB: a larger image is refused")] = 32
    security: SecurityConfig = SecurityConfig()


def session_config(config: ZenohConfig, folder: Path, inputs: Sequence[str], outputs: Sequence[str]) -> "zenoh.Config":
    """The session's configuration; inputs, outputs: key expressions. Raises ConfigError."""
    check(config)
    _check_keys(inputs)
    settings: dict[str, Any] = {
        "mode": config.mode,
        "listen/endpoints": config.listen,
        "connect/endpoints": config.connect,
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2},
        **_CLOSED,
        "transport/link/rx/max_message_size": config.largest_image_mb * 1_000_000,
        f"{_QUEUE}/congestion_control/drop/wait_before_drop": 100,  # us; the estimate is newer than what waits
        f"{_QUEUE}/congestion_control/drop/max_wait_before_drop_fragments": 1000,
        f"{_QUEUE}/congestion_control/block/wait_before_close": 500_000,  # us; a peer that takes no declarations is dropped
        **{f"{_QUEUE}/size/{priority}": _MOST_BATCHES for priority in _PATIENT},  # a busy machine is no congestion
        **_identity(config.security, folder),
        **_doorkeeper(config.security, folder, inputs, outputs),
    }
    return _made(settings)


def client_config(config: ZenohConfig, folder: Path, endpoint: str) -> "zenoh.Config":
    """Of a listening client with the configured identity. Raises ConfigError."""
    _check_endpoint("connect", endpoint)
    return _made({"mode": "client", "connect/endpoints": [endpoint], **_CLOSED, **_identity(config.security, folder)})


def _made(settings: dict[str, Any]) -> "zenoh.Config":
    import zenoh  # noqa: PLC0415  (every command reads the configuration, few open a session)

    made = zenoh.Config()
    for key, value in settings.items():
        made.insert_json5(key, json.dumps(value))
    return made


def _check_keys(inputs: Sequence[str]) -> None:
    import zenoh  # noqa: PLC0415

    for key in inputs:
        try:
            zenoh.KeyExpr(key)
        except zenoh.ZError as error:
            raise ConfigError(f"[inputs]: a topic cannot be named so: {first_sentence(error)}") from None


def first_sentence(error: Exception) -> str:
    """The text of a ZError, without the place in Zenoh's own source."""
    return str(error).split(" at ", 1)[0].strip()


class Endpoint(NamedTuple):
    """PROTOCOL/HOST:PORT?metadata#settings; without ports host is the address, port empty."""

    protocol: str
    host: str
    port: str
    settings: frozenset[str]

    @classmethod
    def of(cls, text: str) -> "Endpoint":
        """Parts of an endpoint, unchecked."""
        protocol, _, rest = text.partition("/")
        place, _, behind = rest.partition("#")
        address, settings = place.partition("?")[0], frozenset(s.partition("=")[0] for s in behind.split(";") if s)
        if protocol not in _WITH_PORT:
            return cls(protocol, address, "", settings)
        host, _, port = address.rpartition(":")
        return cls(protocol, host[1:-1] if host[:1] + host[-1:] == "[]" else host, port, settings)


def check(config: ZenohConfig) -> None:
    """Raises ConfigError for an open endpoint beyond loopback, or unchecked names."""
    security = config.security
    proofs = {"listen": bool(security.users_file), "connect": bool(security.user and security.password_file)}
    for name, endpoints in (("listen", config.listen), ("connect", config.connect)):
        for endpoint in endpoints:
            _check_endpoint(name, endpoint)
            if not (is_local(endpoint) or security.insecure):
                _check_protected(name, endpoint, by_password=proofs[name], by_certificate=bool(security.certificate_file))
    named = bool(security.feeders or security.listeners)
    if named and security.names_are == "users" and not security.users_file:
        raise ConfigError("zenoh.security.users_file: is needed where feeders and listeners are users")
    if named and security.names_are == "certificates" and not security.certificate_file:
        raise ConfigError("zenoh.security.certificate_file: is needed where feeders and listeners are certificates")
    if security.certificate_file and not (security.key_file and security.ca_file):
        raise ConfigError("zenoh.security: certificate_file needs key_file and ca_file as well")
    if security.user and not security.password_file:
        raise ConfigError("zenoh.security.password_file: is needed with user")


def _check_endpoint(name: str, text: str) -> None:
    endpoint = Endpoint.of(text)
    with_port = bool(endpoint.host) and endpoint.port.isdecimal() and int(endpoint.port) <= _LARGEST_PORT
    if not (with_port if endpoint.protocol in _WITH_PORT else endpoint.protocol in _WITHOUT_PORT and endpoint.host):
        raise ConfigError(f"zenoh.{name} = {text}: is not PROTOCOL/HOST:PORT, such as tcp/127.0.0.1:7447")


def _check_protected(name: str, text: str, *, by_password: bool, by_certificate: bool) -> None:
    """A multicast group has no authentication."""
    endpoint = Endpoint.of(text)
    if by_password and not _is_multicast(endpoint.host):
        return
    if by_certificate and endpoint.protocol in _WITH_CERTIFICATE:
        if undone := sorted(endpoint.settings - _HARMLESS):
            raise ConfigError(f"zenoh.{name} = {text}: {undone[0]} behind '#' may undo the certificates; leave it out")
        return
    password = "users_file" if name == "listen" else "user and password_file"
    raise ConfigError(
        f"zenoh.{name} = {text}: is open to everybody in reach; write tls/HOST:PORT and set [zenoh.security] ca_file, "
        f"certificate_file and key_file, or set {password} (insecure = true if that is meant)"
    )


def _is_multicast(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_multicast
    except ValueError:
        return False


def is_local(text: str) -> bool:
    """Whether only this machine can reach the endpoint."""
    endpoint = Endpoint.of(text)
    return endpoint.protocol in _LOCAL_PROTOCOLS or (endpoint.protocol in _WITH_PORT and is_loopback(endpoint.host))


def _identity(security: SecurityConfig, folder: Path) -> dict[str, Any]:
    settings: dict[str, Any] = {}
    if security.user and security.password_file:
        settings["transport/auth/usrpwd/user"] = security.user
        settings["transport/auth/usrpwd/password"] = read_secret("zenoh.security.password_file", folder / security.password_file)
    if security.certificate_file and security.key_file and security.ca_file:
        settings |= {
            "transport/link/tls/root_ca_certificate": _file(folder, security.ca_file),
            "transport/link/tls/connect_certificate": _file(folder, security.certificate_file),
            "transport/link/tls/connect_private_key": _secret(folder, "key_file", security.key_file),
            "transport/link/tls/enable_mtls": True,
        }
    return settings


def _doorkeeper(security: SecurityConfig, folder: Path, inputs: Sequence[str], outputs: Sequence[str]) -> dict[str, Any]:
    settings: dict[str, Any] = {}
    if security.users_file:
        settings["transport/auth/usrpwd/dictionary_file"] = _secret(folder, "users_file", security.users_file)
    if security.certificate_file and security.key_file:
        settings["transport/link/tls/listen_certificate"] = _file(folder, security.certificate_file)
        settings["transport/link/tls/listen_private_key"] = _secret(folder, "key_file", security.key_file)
    if security.feeders or security.listeners:
        settings["access_control"] = access_control(security, inputs, outputs)
        settings["transport/shared_memory/enabled"] = False  # a way around the access control
    return settings


def access_control(security: SecurityConfig, inputs: Sequence[str], outputs: Sequence[str]) -> dict[str, Any]:
    """Access control: all denied but what feeders and listeners need.

    A feeder needs our subscription (egress) before it sends (ingress).
    """
    rules = [
        _rule("feed", "ingress", ["put", "liveliness_token"], [*inputs, "@ros2_lv/**"]),
        _rule("ask-for-input", "egress", ["declare_subscriber"], inputs),
        _rule("publish", "egress", ["put", "reply", "declare_queryable", "liveliness_token"], [*outputs, "@ros2_lv/**", "@/**"]),
        _rule(
            "listen",
            "ingress",
            ["declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query"],
            [*outputs, "@ros2_lv/**", "@/**"],
        ),
    ]
    kind = {"users": "usernames", "certificates": "cert_common_names", "interfaces": "interfaces"}[security.names_are]
    subjects, policies = [], []
    for name, members, allowed in (
        ("feeders", security.feeders, ["feed", "ask-for-input"]),
        ("listeners", security.listeners, ["publish", "listen"]),
    ):
        if members:
            subjects.append({"id": name, kind: list(members)})
            policies.append({"rules": allowed, "subjects": [name]})
    return {"enabled": True, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies}


def _rule(name: str, flow: str, messages: list[str], keys: Iterable[str]) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": list(keys)}


def _file(folder: Path, name: str) -> str:
    path = folder / name
    if not path.is_file():
        raise ConfigError(f"[zenoh.security] {path}: no such file; paths count from the configuration's folder")
    return str(path)


def _secret(folder: Path, key: str, name: str) -> str:
    path = _file(folder, name)
    check_secret(f"zenoh.security.{key}", Path(path))
    return path
