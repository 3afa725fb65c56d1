"""A flight whose log rotates in the air is replayed whole from its parts."""

from pathlib import Path

import pytest

from estimator.config import parse
from estimator.replay.replay import replay
from tests.estimator.service.flying import client, fly, free_port, in_thread, logs_of, said, toml, until


@pytest.mark.long
def test_the_parts_of_a_flight_replay_to_what_was_flown(tmp_path: Path) -> None:
    port = free_port()
    text = toml(tmp_path, port, more="rotate_mb = 0.05")
    with in_thread(parse(text), tmp_path) as daemon, client(port) as session:
        while len(logs_of(tmp_path)) < 3:
            fly(session, 1.0)
        until(lambda: len(daemon.mailbox) == 0, "all is handled")
    parts = logs_of(tmp_path)
    summary = replay(parts[0].parent, tmp_path / "again.mcap", parse(text))
    flown = [message for part in parts for message in said(part)]
    assert summary.estimates > 100
    assert said(tmp_path / "again.mcap") == flown
    replay(parts[1:], tmp_path / "late.mcap", parse(text))
    assert said(tmp_path / "late.mcap") != [message for part in parts[1:] for message in said(part)]
