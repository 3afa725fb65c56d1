"""What foreign readers print reaches nobody, and afterwards the streams are what they were."""

import os
import subprocess
import sys

import pytest

from models.untrusted.quiet import silence

_HEAVY = {"scipy.stats", "logs.findings", "logs.importers"}


def test_neither_python_nor_the_process_prints_within(capfd: pytest.CaptureFixture[str]) -> None:
    with silence():
        print("by Python")
        os.write(2, b"by a library")
    print("afterwards")
    assert capfd.readouterr() == ("afterwards\n", "")


def test_a_photo_is_read_without_the_importers_of_logs() -> None:
    """`landfix locate` spent a quarter of its time on modules that it does not use."""
    loaded = (
        "import sys, estimator.commands.photo.shots, estimator.map_files.image, logs.wire.images, models.radius;"
        "print(*sys.modules)"
    )
    names = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True).stdout.split()
    assert not _HEAVY & set(names)
