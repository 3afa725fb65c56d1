"""Closed by default; and who is not known gets nothing and can feed nothing."""

import shutil
import socket
import subprocess
import time
from contextlib import suppress
from pathlib import Path

import msgspec
import pytest
import zenoh

from benchmarks.service.vehicle import Vehicle, connected
from estimator.config import Config, ConfigError, parse
from estimator.service.zenoh.config import SecurityConfig, ZenohConfig, check, session_config
from tests.estimator.service.flying import ask, client, fly, free_port, in_thread, listening, logs_of, records, toml

_USERS = "alice:flies\nbob:watches\neve:guesses\n"


def _session(**config: object) -> ZenohConfig:
    return ZenohConfig(**config)  # type: ignore[arg-type]


def test_by_default_nothing_but_loopback_is_listened_to_and_nobody_is_scouted_for(tmp_path: Path) -> None:
    port = free_port()
    with in_thread(parse(toml(tmp_path, port)), tmp_path):
        assert listening(port)
        mine = _listened_to()
    assert {address for address, p in mine if p == port} == {"127.0.0.1"}
    assert {p for address, p in mine if address not in {"127.0.0.1", "::1"}} == set()
    made = session_config(ZenohConfig(), tmp_path, [], [])
    assert msgspec.json.decode(str(made))["scouting"]["multicast"]["enabled"] is False
    assert msgspec.json.decode(str(made))["scouting"]["gossip"]["enabled"] is False


def _listened_to() -> set[tuple[str, int]]:
    """(address, port) of the TCP sockets on which this process listens, and of its UDP sockets."""
    inodes = set()
    for fd in Path("/proc/self/fd").iterdir():
        with suppress(OSError):
            inodes.add(fd.readlink().name)
    found = set()
    for table, family in (("tcp", socket.AF_INET), ("tcp6", socket.AF_INET6), ("udp", socket.AF_INET)):
        for line in Path(f"/proc/self/net/{table}").read_text().splitlines()[1:]:
            local, state, inode = (line.split()[k] for k in (1, 3, 9))
            if f"socket:[{inode}]" in inodes and (state == "0A" or table == "udp"):
                raw, _, port = local.partition(":")
                words = b"".join(bytes.fromhex(raw[k : k + 8])[::-1] for k in range(0, len(raw), 8))
                found.add((socket.inet_ntop(family, words), int(port, 16)))
    return found


_MUTUAL_TLS = SecurityConfig(ca_file="ca.pem", certificate_file="us.pem", key_file="us.key")
_USERS_FILE, _PASSWORD = SecurityConfig(users_file="users"), SecurityConfig(user="us", password_file="password")
_BEYOND = (
    "tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/*:7447", "udp/192.168.1.2:7447", "ws/10.0.0.1:7447", "tcp/169.254.1.1:7447",
    "tcp/127.evil.example:7447", "tcp/127.0.0.1.evil.example:7447", "tcp/localhost.evil.example:7447", "tcp/Localhost:7447",
    "tcp/127.1:7447", "tcp/0x7f000001:7447", "tcp/2130706433:7447", "tcp/0.0.0.0:7447#iface=lo", "tcp/0.0.0.0:7447?127.0.0.1:1",
    "tcp/[fe80::1%eth0]:7447", "tcp/[::1%eth0]:7447", "tcp/[::ffff:10.0.0.1]:7447", "udp/224.0.0.224:7447", "vsock/-1:7447",
    "serial//dev/ttyUSB0#baudrate=9600",
)  # fmt: skip
_LOOPBACK = (
    "tcp/127.0.0.1:7447", "udp/127.9.9.9:7447", "tcp/localhost:7447", "tcp/[::1]:7447", "ws/[::ffff:127.0.0.1]:7447",
    "tls/127.0.0.1:7447#enable_mtls=false", "tcp/127.0.0.1:7447?prio=1-7#so_sndbuf=1", "unixsock-stream//run/landfix.sock",
    "unixpipe//run/p",
)  # fmt: skip


@pytest.mark.parametrize("side", ["listen", "connect"])
@pytest.mark.parametrize("endpoint", _BEYOND)
def test_an_endpoint_beyond_loopback_that_nothing_protects_is_refused(endpoint: str, side: str) -> None:
    for security in (SecurityConfig(), _MUTUAL_TLS, SecurityConfig(names_are="interfaces", feeders=("eth0",))):
        with pytest.raises(ConfigError, match=f"^zenoh.{side} = .*: is open to everybody in reach; write tls/") as refused:
            check(_session(**{"listen": (), side: (endpoint,)}, security=security))
        assert "\n" not in str(refused.value)
    check(_session(**{"listen": (), side: (endpoint,)}, security=SecurityConfig(insecure=True)))


@pytest.mark.parametrize("side", ["listen", "connect"])
@pytest.mark.parametrize("endpoint", _LOOPBACK)
def test_what_only_this_machine_can_reach_needs_no_protection(endpoint: str, side: str) -> None:
    check(_session(**{"listen": (), side: (endpoint,)}))


@pytest.mark.parametrize("endpoint", ["tls/0.0.0.0:7447", "quic/[::]:7447", "tls/vehicle7:7447#iface=eth0"])
def test_certificates_protect_tls_and_quic(endpoint: str) -> None:
    for side in ("listen", "connect"):
        check(_session(**{"listen": (), side: (endpoint,)}, security=_MUTUAL_TLS))
        with pytest.raises(ConfigError, match="is open to everybody"):
            check(_session(**{"listen": (), side: (endpoint,)}))
        for undone in (
            "#enable_mtls=false",
            "#verify_name_on_connect=false",
            "#iface=eth0;root_ca_certificate_file=/tmp/any.pem",
        ):
            with pytest.raises(ConfigError, match="behind '#' may undo the certificates"):
                check(_session(**{"listen": (), side: (endpoint.partition("#")[0] + undone,)}, security=_MUTUAL_TLS))


def test_one_open_endpoint_beside_protected_ones_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"tcp/0\.0\.0\.0:7447: is open to everybody"):
        check(_session(listen=("tls/0.0.0.0:7448", "tcp/0.0.0.0:7447"), security=_MUTUAL_TLS))


def test_passwords_protect_whom_they_are_asked_of() -> None:
    for endpoint in ("tcp/10.0.0.1:7447", "udp/[fe80::1%eth0]:7447", "serial//dev/ttyUSB0"):
        check(_session(listen=(endpoint,), security=_USERS_FILE))
        check(_session(listen=(), connect=(endpoint,), security=_PASSWORD))
        with pytest.raises(ConfigError, match="or set users_file"):
            check(_session(listen=(endpoint,), security=_PASSWORD))
        with pytest.raises(ConfigError, match="or set user and password_file"):
            check(_session(listen=(), connect=(endpoint,), security=_USERS_FILE))
    with pytest.raises(ConfigError, match="is open to everybody"):  # a multicast group has no handshake
        check(_session(listen=("udp/224.0.0.224:7447",), security=_USERS_FILE))


@pytest.mark.parametrize(
    "endpoint", ["", "tcp", "tcp/", "tcp/:7447", "tcp/127.0.0.1", "tcp/127.0.0.1:99999", "TCP/127.0.0.1:1", "x/y:1"]
)
def test_what_is_no_endpoint_is_refused(endpoint: str) -> None:
    with pytest.raises(ConfigError, match="is not PROTOCOL/HOST:PORT"):
        check(_session(listen=(endpoint,)))


@pytest.mark.parametrize(
    ("config", "said"),
    [
        (_session(security=SecurityConfig(feeders=("alice",))), "users_file"),
        (_session(security=SecurityConfig(feeders=("alice",), names_are="certificates")), "certificate_file"),
        (_session(security=SecurityConfig(certificate_file="a.pem")), "key_file"),
        (_session(security=SecurityConfig(user="alice")), "password_file"),
    ],
)
def test_names_that_nobody_checks_are_refused(config: ZenohConfig, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        check(config)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="users: no such file"):
        session_config(_session(security=SecurityConfig(users_file="users")), tmp_path, [], [])


def test_users_are_let_in_by_password_and_may_do_what_they_are_named_for(tmp_path: Path) -> None:
    port = free_port()
    (tmp_path / "users").write_text(_USERS)
    (tmp_path / "users").chmod(0o600)
    text = toml(tmp_path, port) + '[zenoh.security]\nusers_file = "users"\nfeeders = ["alice"]\nlisteners = ["alice", "bob"]\n'
    with in_thread(parse(text), tmp_path):
        with pytest.raises(zenoh.ZError), client(port):
            pass
        with pytest.raises(zenoh.ZError), client(port, **_as("bob", "wrong")):
            pass
        with client(port, **_as("eve", "guesses")) as eve, client(port, **_as("bob", "watches")) as bob:
            heard_by_eve, heard_by_bob = Vehicle(eve, 1), Vehicle(bob, 1)
            for refused in (heard_by_eve, heard_by_bob):
                refused.fly(1.0, 200.0, gnss_hz=5.0, fix_hz=5.0)
            with client(port, **_as("alice", "flies")) as alice:
                vehicle = fly(alice, 2.0)
            assert ask(eve, "landfix/config") == []
            assert len(ask(bob, "landfix/config")) == 1
    assert len(vehicle.latency_ns) > 100
    assert len(heard_by_bob.latency_ns) > 100
    assert heard_by_eve.latency_ns == []
    assert len(records(logs_of(tmp_path)[0], "/imu")) == vehicle.sent["/imu"]


def _as(user: str, password: str) -> dict[str, object]:
    return {"transport__auth__usrpwd__user": user, "transport__auth__usrpwd__password": password}


@pytest.mark.parametrize(("interface", "heard"), [("lo", True), ("eth77", False)])
def test_links_without_names_are_distinguished_by_their_interface(tmp_path: Path, interface: str, heard: bool) -> None:
    port = free_port()
    names = f'names_are = "interfaces"\nfeeders = ["{interface}"]\nlisteners = ["{interface}"]\n'
    with in_thread(parse(toml(tmp_path, port) + "[zenoh.security]\n" + names), tmp_path), client(port) as session:
        vehicle = fly(session, 1.5)
    assert (len(vehicle.latency_ns) > 50) is heard
    assert (len(records(logs_of(tmp_path)[0], "/imu")) > 0) is heard


def test_certificates_let_in_whom_the_authority_signed(tmp_path: Path) -> None:
    if shutil.which("openssl") is None:
        pytest.skip("no openssl to make certificates with")
    _authority(tmp_path, "ca")
    for name in ("daemon", "alice", "eve"):
        _certificate(tmp_path, name, "ca")
    _authority(tmp_path, "other")
    _certificate(tmp_path, "mallory", "other")
    port = free_port()
    text = toml(tmp_path, port).replace("tcp/", "tls/") + (
        '[zenoh.security]\nca_file = "ca.pem"\ncertificate_file = "daemon.pem"\nkey_file = "daemon.key"\n'
        'names_are = "certificates"\nfeeders = ["alice"]\nlisteners = ["alice"]\n'
    )
    endpoint = f"tls/localhost:{port}"
    with in_thread(parse(text.replace("tls/127.0.0.1", "tls/localhost")), tmp_path):
        eve = connected(endpoint, **_with(tmp_path, "eve"))
        alice = connected(endpoint, **_with(tmp_path, "alice"))
        for stranger in ({"transport__link__tls__root_ca_certificate": str(tmp_path / "ca.pem")}, _with(tmp_path, "mallory")):
            with pytest.raises(zenoh.ZError):
                connected(endpoint, **stranger)
        by_eve = Vehicle(eve, 1)
        by_eve.fly(1.0, 200.0, gnss_hz=5.0, fix_hz=5.0)
        by_alice = fly(alice, 2.0)
        time.sleep(0.2)
        eve.close()  # type: ignore[no-untyped-call]
        alice.close()  # type: ignore[no-untyped-call]
    assert len(by_alice.latency_ns) > 100
    assert by_eve.latency_ns == []
    assert len(records(logs_of(tmp_path)[0], "/imu")) == by_alice.sent["/imu"]


def _openssl(folder: Path, *words: str) -> None:
    subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True)


def _authority(folder: Path, name: str) -> None:
    _openssl(folder, "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2",
             "-subj", f"/CN={name}", "-keyout", f"{name}.key", "-out", f"{name}.pem")  # fmt: skip


def _certificate(folder: Path, name: str, authority: str) -> None:
    (folder / "ext").write_text("subjectAltName=DNS:localhost\nbasicConstraints=CA:FALSE\n")
    _openssl(folder, "req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-subj", f"/CN={name}",
             "-keyout", f"{name}.key", "-out", f"{name}.csr")  # fmt: skip
    _openssl(folder, "x509", "-req", "-in", f"{name}.csr", "-CA", f"{authority}.pem", "-CAkey", f"{authority}.key",
             "-CAcreateserial", "-days", "2", "-extfile", "ext", "-out", f"{name}.pem")  # fmt: skip


def _with(folder: Path, name: str) -> dict[str, object]:
    tls = "transport__link__tls__"
    return {
        f"{tls}root_ca_certificate": str(folder / "ca.pem"),
        f"{tls}enable_mtls": True,
        f"{tls}connect_certificate": str(folder / f"{name}.pem"),
        f"{tls}connect_private_key": str(folder / f"{name}.key"),
    }


def test_the_configuration_that_is_logged_holds_no_password(tmp_path: Path) -> None:
    (tmp_path / "password").write_text("secret\n")
    (tmp_path / "password").chmod(0o600)
    config = parse('[zenoh.security]\nuser = "landfix"\npassword_file = "password"')
    assert isinstance(config, Config)
    assert "secret" not in config.toml()
    made = str(session_config(config.zenoh, tmp_path, [], []))
    assert "landfix" in made
