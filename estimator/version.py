"""Which landfix this is."""

from importlib import metadata


def version() -> str:
    """The installed version; "0+source" where the program runs from a source folder that was never installed."""
    try:
        return metadata.version("landfix")
    except metadata.PackageNotFoundError:
        return "0+source"
