"""Passwords and passphrases, each in a file of its own."""

from pathlib import Path

from estimator.strict_toml import ConfigError


def read_secret(key: str, path: Path) -> str:
    """The text of a file that the configuration names under a key. Raises ConfigError."""
    try:
        secret = path.read_text(encoding="utf-8").strip()
    except OSError as error:
        raise ConfigError(f"{key} = {path}: {(error.strerror or 'cannot be read').lower()}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{key} = {path}: is not a text file") from None
    if not secret:
        raise ConfigError(f"{key} = {path}: is empty")
    return secret
