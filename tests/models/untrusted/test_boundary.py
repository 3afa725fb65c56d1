"""What passes the boundary is one line."""

import pytest

from models.untrusted.boundary import refusing


class _Error(Exception):
    pass


def test_an_error_of_several_lines_becomes_one() -> None:
    with pytest.raises(_Error) as caught, refusing(_Error, "a.bin"):
        raise _Error("a.bin: unsupported\nformat\x1b[31m")
    assert str(caught.value) == "a.bin: unsupported format [31m"
