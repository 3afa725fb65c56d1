"""Secrets in files that only their owner may access."""

import shlex
import stat
from pathlib import Path

from estimator.strict_toml import ConfigError

_OTHERS = stat.S_IRWXG | stat.S_IRWXO


def check_secret(key: str, path: Path) -> None:
    """Raises ConfigError for a secret that others may access, or no file."""
    try:
        mode = path.stat().st_mode
    except OSError as error:
        raise ConfigError(f"{key} = {path}: {(error.strerror or 'cannot be read').lower()}") from None
    if not stat.S_ISREG(mode):
        raise ConfigError(f"{key} = {path}: is no file")
    if mode & _OTHERS:
        raise ConfigError(f"{key} = {path}: others may use this secret; type: chmod 600 {shlex.quote(str(path))}")


def read_secret(key: str, path: Path) -> str:
    """Text of a secret file named under `key`. Raises ConfigError."""
    check_secret(key, path)
    try:
        secret = path.read_text(encoding="utf-8").strip()
    except OSError as error:
        raise ConfigError(f"{key} = {path}: {(error.strerror or 'cannot be read').lower()}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{key} = {path}: is not a text file") from None
    if not secret:
        raise ConfigError(f"{key} = {path}: is empty")
    return secret
