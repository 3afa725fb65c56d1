"""Can `landfix run` start with this configuration, as this user?"""

import errno
import os
import shutil
import socket
import stat
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from calib.errors import CalibrationError
from estimator.config import Config
from estimator.service.log.recovery import FolderError, FolderLock
from estimator.service.mavlink.config import Serial, address_of, signing_key
from estimator.service.zenoh.config import Endpoint, is_local, session_config
from estimator.service.zenoh.keys import plain_key
from estimator.strict_toml import ConfigError
from estimator.tools.doctor.machine import Check, judge

_ANSWER_S: Final = 1.0
_ANY_KEY: Final = "landfix/doctor"  # which keys may be read is not what is asked here
_OTHERS: Final = stat.S_IWGRP | stat.S_IWOTH
_ANYBODY: Final = stat.S_IRWXO
_ADVICE: Final = {
    errno.EADDRINUSE: "another program has it: a landfix that runs already?",
    errno.EADDRNOTAVAIL: "this computer has no such address now: mend it, or bring its interface up",
    errno.EACCES: "ports below 1024 are the system's: take a higher one",
}


def flight(config: Config, folder: Path) -> list[Check]:
    """All checks; folder: base of the configuration's files. Leaves nothing, sends nothing."""
    return [
        *_cameras(config, folder),
        *_zenoh(config, folder),
        *_mavlink(config, folder),
        *_log(config),
        package(Path(__file__).parents[2]),
    ]


def _cameras(config: Config, folder: Path) -> Iterator[Check]:
    given = {
        "[rig] file": config.rig.file,
        "[map] landmarks or picture": config.map.landmarks or config.map.picture,
        "[inputs] left_image": config.inputs.left_image,
    }
    missing = [key for key, value in given.items() if not value]
    if config.rig.file and missing:
        advice = f"give {' and '.join(missing)}, or leave the rig out"
        yield judge("vision", "off", warn=True, advice=advice)
    if not config.rig.file or not (folder / config.rig.file).is_file():
        return
    from calib.files.formats import load_cameras  # noqa: PLC0415  (OpenCV: an installation without cameras has none)

    try:
        rig = load_cameras(folder / config.rig.file)
    except CalibrationError as error:
        yield judge("rig", str(error), fail=True, advice="landfix calibrate stereo writes one; convert reads other formats")
        return
    known = rig.covariance_bc is not None and (rig.one_camera or rig.covariance_rc is not None)
    apart = "one camera" if rig.one_camera else f"{1e3 * rig.baseline_m:.0f} mm apart"
    found = f"{rig.left.width} x {rig.left.height} px, {apart}"
    advice = "it gives no covariances, so fixes will claim to be better than they are; calibrate with landfix"
    yield judge("rig", found, warn=not known, advice=advice)


def _zenoh(whole: Config, folder: Path) -> Iterator[Check]:
    config, inputs = whole.zenoh, whole.inputs
    if not config.enabled:
        yield judge("zenoh", "off")
        return
    topics = (*whole.decoder().types, *inputs.left_image, *inputs.right_image)
    try:
        session_config(config, folder, [plain_key(topic) for topic in topics], [_ANY_KEY])
    except (ConfigError, OSError) as error:
        yield judge("zenoh", str(error), fail=True, advice="docs/daemon.md has a recipe for users, certificates and access")
        return
    for endpoint in config.listen:
        reach = "this machine only" if is_local(endpoint) else "open to the network, as configured"
        yield _port("zenoh.listen", endpoint, _refused(endpoint), reach)
    for endpoint in config.connect:
        answers = _answers(endpoint)
        found = f"{endpoint}: {'answers' if answers else 'no answer'}"
        yield judge(
            "zenoh.connect", found, warn=not answers, advice="start the router, or mend the address; landfix keeps trying"
        )
    for name in ("users_file", "password_file", "key_file"):
        if given := getattr(config.security, name):
            yield judge(f"zenoh.security.{name}", f"{folder / given}: for its owner only")


def _refused(endpoint: str) -> OSError | None:
    protocol, host, port, _ = Endpoint.of(endpoint)
    kinds = {"tcp": socket.SOCK_STREAM, "tls": socket.SOCK_STREAM, "udp": socket.SOCK_DGRAM, "quic": socket.SOCK_DGRAM}
    if protocol not in kinds or not port.isdecimal():
        return None
    return _bound(host, int(port), kinds[protocol])


def _bound(host: str, port: int, kind: socket.SocketKind) -> OSError | None:
    try:
        family, _, _, _, place = socket.getaddrinfo(host, port, type=kind)[0]
        with socket.socket(family, kind) as one:
            if kind == socket.SOCK_STREAM:
                one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # a connection that has just ended does not matter
            one.bind(place)
    except OSError as error:
        return error
    return None


def _port(name: str, endpoint: str, flaw: OSError | None, good: str) -> Check:
    if flaw is None:
        return judge(name, f"{endpoint}: {good}")
    found = f"{endpoint}: {(flaw.strerror or 'cannot be listened on').lower()}"
    return judge(name, found, warn=True, advice=_ADVICE.get(flaw.errno or 0, "mend the address"))


def _answers(endpoint: str) -> bool:
    protocol, host, port, _ = Endpoint.of(endpoint)
    if protocol not in {"tcp", "tls"} or not port.isdecimal():
        return True
    with suppress(OSError), socket.create_connection((host, int(port)), timeout=_ANSWER_S):
        return True
    return False


def _mavlink(whole: Config, folder: Path) -> Iterator[Check]:
    config = whole.mavlink
    if not config.endpoint:
        yield judge("mavlink", "off")
        return
    try:
        address = address_of(config)
        key = signing_key(config, folder)
    except ConfigError as error:
        yield judge("mavlink", str(error), fail=True, advice="landfix doctor --config --all lists the keys of [mavlink]")
        return
    if isinstance(address, Serial):
        yield _device(Path(address.path))
    elif address.listens:
        yield _port("mavlink.endpoint", config.endpoint, _bound(address.host, address.port, socket.SOCK_DGRAM), "free")
    else:
        yield judge("mavlink.endpoint", f"{config.endpoint}: landfix begins to talk")
    if key is not None:
        yield judge("mavlink.signing_key_file", f"{folder / config.signing_key_file}: for its owner only")


def _device(path: Path) -> Check:
    name = "mavlink.endpoint"
    if not path.exists():
        return judge(name, f"{path}: is not there", warn=True, advice="plug the autopilot in; landfix keeps searching for it")
    if not path.is_char_device():
        return judge(name, f"{path}: is no serial device", fail=True, advice="such as /dev/ttyACM0; or udpin:HOST:PORT")
    if not os.access(path, os.R_OK | os.W_OK):
        group = path.group() if path.owner() == "root" else "dialout"
        advice = f"let this user in: sudo usermod -aG {group} $USER, then log in again"
        return judge(name, f"{path}: no permission to read and write", fail=True, advice=advice)
    return judge(name, f"{path}: there")


def _log(config: Config) -> Iterator[Check]:
    if not (config.log.enabled or config.service.state_file):
        yield judge("log.folder", "off", warn=True, advice="a flight without a log teaches nothing; set [log] enabled = true")
        return
    folder = Path(config.log.folder).absolute()
    existing = next(p for p in (folder, *folder.parents) if p.exists())
    try:
        if existing == folder:
            _try_to_claim(folder)
        with tempfile.TemporaryFile(dir=existing):
            pass
    except FolderError as error:
        yield judge("log.folder", str(error), warn=True, advice="end the other one, or set [log] folder")
        return
    except OSError as error:
        advice = "set [log] folder to a place this user may write to"
        yield judge("log.folder", f"{folder}: {(error.strerror or 'cannot be used').lower()}", fail=True, advice=advice)
        return
    free = shutil.disk_usage(existing).free
    least = 1e6 * config.log.least_free_mb
    found = f"{folder}: {free / 1e9:.1f} GB free"
    state = folder / config.service.state_file
    if config.service.state_file and state.parent != folder and not os.access(state.parent, os.W_OK):
        advice = "without it a restart begins without a state: name a file, it is kept in the folder of the logs"
        yield judge("service.state_file", f"{state}: cannot be written", warn=True, advice=advice)
    if existing == folder and folder.stat().st_mode & _ANYBODY:
        advice = f"they show where the vehicle flew: chmod 750 {folder}"
        yield judge("log.permissions", f"{folder}: anybody on this machine may read the logs", warn=True, advice=advice)
    advice = f"the log pauses below {config.log.least_free_mb:.0f} MB: delete old ones, or set [log] keep_gb"
    yield judge("log.folder", found, fail=free < least, warn=free < 10.0 * least, advice=advice)


def _try_to_claim(folder: Path) -> None:
    known = set(folder.iterdir())
    with FolderLock(folder) as lock:
        if lock.path not in known:
            lock.path.unlink()


def package(home: Path, owners: Sequence[int] | None = None) -> Check:
    """The installed code must not be writable by others; owners: user ids, None: root and this user."""
    trusted = set(owners if owners is not None else (0, os.getuid()))
    for path in (home, *sorted(home.rglob("*.py"))):
        seen = path.stat()
        if seen.st_mode & stat.S_IWOTH or (seen.st_mode & _OTHERS and seen.st_gid not in {0, os.getgid()}):
            return judge("package", f"{path}: others may change it", warn=True, advice=f"chmod -R go-w {home}")
        if seen.st_uid not in trusted:
            found = f"{path}: belongs to user {seen.st_uid}"
            return judge("package", found, warn=True, advice=f"install it as root or as this user: sudo chown -R $USER {home}")
    return judge("package", f"{home}: writable by no other user")
