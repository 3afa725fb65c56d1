"""A bag is read by its first bytes, whatever its name says."""

from pathlib import Path

import pytest

from benchmarks.attacks import seeds
from logs.importers.rosbag.bag import Bag


@pytest.mark.parametrize(("content", "name"), [("mcap", "a.bag"), ("bag", "a.mcap")])
def test_a_bag_of_another_name_is_read(content: str, name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(seeds.of(content)[0])
    assert "/imu" in {record.topic for record in Bag(tmp_path / name).messages()}
