"""Which flights a list of addresses means."""

from pathlib import Path

import pytest

from estimator.tools.fleet.errors import FleetError
from estimator.tools.fleet.store import flights


def test_parts_of_one_flight_are_one(tmp_path: Path) -> None:
    for name in ("landfix-1-000.mcap", "landfix-1-001.mcap", "other.mcap"):
        (tmp_path / name).write_bytes(b"x")
    first, second = flights([f"{tmp_path}/*.mcap"])
    assert (first.log, first.parts) == (f"{tmp_path}/landfix-1", tuple(f"{tmp_path}/landfix-1-00{k}.mcap" for k in range(2)))
    assert (second.log, second.stored_bytes) == (f"{tmp_path}/other.mcap", 1)


def test_a_list_file_names_addresses_and_a_file_counts_once(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"x")
    (tmp_path / "list.txt").write_text(f"# of Monday\n{tmp_path}/a.mcap\n\n{tmp_path}/*.mcap\n")
    assert [flight.log for flight in flights([f"{tmp_path}/list.txt"])] == [f"{tmp_path}/a.mcap"]


def test_another_content_is_another_state(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"x")
    (before,) = flights([f"{tmp_path}/a.mcap"])
    assert flights([f"{tmp_path}/a.mcap"]) == [before]
    (tmp_path / "a.mcap").write_bytes(b"xy")
    assert flights([f"{tmp_path}/a.mcap"])[0].state != before.state


@pytest.mark.parametrize("address", ["{}/no.mcap", "{}/no*.mcap", "{}", "nothing://bucket/a.mcap", "{}/no.txt"])
def test_what_is_not_there_is_said_in_one_line(tmp_path: Path, address: str) -> None:
    with pytest.raises(FleetError) as error:
        flights([address.format(tmp_path)])
    assert "\n" not in str(error.value)
    assert address.format(tmp_path) in str(error.value)
