"""Which landfix this is."""

from importlib import metadata


def version() -> str:
    """The installed version; "0+source" from a source folder."""
    try:
        return metadata.version("landfix")
    except metadata.PackageNotFoundError:
        return "0+source"
