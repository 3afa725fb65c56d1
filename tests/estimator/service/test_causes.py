"""What the daemon says of inputs that are at fault."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from benchmarks.service.vehicle import ORIGIN, gnss, imu
from estimator.service import causes
from estimator.service.causes import CauseFinder, causes_of
from logs.store.recorder import Recorder
from logs.wire.codec import encode_input
from models.messages import GnssFix, Health, Mode

T0, S = 1_795_000_000_000_000_000, 10**9


def test_the_cause_is_read_out_of_a_log_that_is_being_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    path = tmp_path / "a.mcap"
    recorder = Recorder(path)
    for t_ns in range(T0, T0 + 20 * S, S // 50):
        recorder.write(*encode_input(imu(t_ns, rng)), t_ns)
        for m in gnss(t_ns, rng) if t_ns % (S // 5) == 0 else ():
            exchanged = msgspec.structs.replace(m, lat_deg=m.lon_deg, lon_deg=m.lat_deg) if isinstance(m, GnssFix) else m
            recorder.write(*encode_input(exchanged), t_ns)
    recorder.flush()
    monkeypatch.setattr(causes, "_SCRIPT", causes._SCRIPT.replace("os.setpriority(os.PRIO_PROCESS, 0, 19)\n", ""))  # busy machine
    assert causes_of(f"[map]\norigin = {[*ORIGIN.lla]}\n", str(path)) == [
        "/gnss since 0.0 s: latitude and longitude are exchanged; mend the driver of the receiver"
    ]
    recorder.close()


def test_a_topic_that_is_found_twice_is_said_once(monkeypatch: pytest.MonkeyPatch) -> None:
    looks = [["/imu since 0.1 s: a; b"], ["/imu since 0.2 s: a; b", "/gnss since 3.0 s: c; d"]]
    monkeypatch.setattr(causes, "_LATEST_S", 0.0)
    monkeypatch.setattr(causes, "_LOOKS_S", (0.0, 0.0))
    monkeypatch.setattr(causes, "causes_of", lambda *_: looks.pop(0))
    lines: list[str] = []
    finder = CauseFinder("", lambda: "", lines.append)
    finder.note(Health(T0, T0, Mode.ALIGNING, float("inf"), float("inf"), 180.0, 0, {}, {}, 0))
    finder._thread.join()
    finder.close()
    assert lines == ["/imu since 0.1 s: a; b", "/gnss since 3.0 s: c; d"]
