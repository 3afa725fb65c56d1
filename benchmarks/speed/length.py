"""What a longer log costs: processor time and peak memory of simulate, replay, evaluate and report by its length.

    python -m benchmarks.speed.length --minutes 10 40 120 --out out/bench/length.json

One made-up flight (multirotor, IMU 100 Hz, fixes 1 Hz, GNSS 1 Hz), each command in a process of its own. Nothing may grow faster
than the log; memory may not grow with it.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

SCENARIO: Final = """
duration_s = {seconds}
origin = [47.0, 8.0, 500.0]
vehicle = {{ kind = "multirotor", speed_m_s = 8.0, area_m = 120.0, height_m = 40.0 }}
imu = {{ grade = "flight_controller", rate_hz = 100.0 }}
gnss = {{ rate_hz = 1.0 }}
pose_fix = {{ rate_hz = 1.0, sigma_m = [0.15, 0.15, 0.15], sigma_deg = [1.0, 1.0, 1.0] }}
"""
COMMANDS: Final = {
    "simulate": ("scenario.toml", "-o", "log.mcap"),
    "replay": ("log.mcap", "-o", "estimate.mcap"),
    "evaluate": ("estimate.mcap", "--json"),
    "report": ("estimate.mcap", "-o", "report.html"),
}


def measure(folder: Path, command: str) -> tuple[float, float]:
    """Processor seconds and peak memory [MB] of one command, its children included. Raises RuntimeError where it fails."""
    with (folder / "said.txt").open("wb") as said:
        process = subprocess.Popen(
            [sys.executable, "-m", "estimator", command, *COMMANDS[command]], cwd=folder, stdout=said, stderr=said
        )
        _, status, used = os.wait4(process.pid, 0)
    if status:
        raise RuntimeError(f"{command}: {(folder / 'said.txt').read_text(errors='replace')[-2000:]}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0


def rows(minutes: float) -> list[dict[str, object]]:
    """One a command."""
    found: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "scenario.toml").write_text(SCENARIO.format(seconds=60.0 * minutes))
        for command in COMMANDS:
            cpu_s, peak_mb = measure(folder, command)
            found.append({"minutes": minutes, "command": command, "cpu_s": round(cpu_s, 1), "peak_MB": round(peak_mb)})
            print(found[-1], flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, nargs="+", default=[10.0, 40.0, 120.0])
    parser.add_argument("--out", type=Path, default=Path("out/bench/length.json"))
    args = parser.parse_args()
    found: list[dict[str, object]] = []
    args.out.parent.mkdir(parents=True, exist_ok=True)
    for minutes in args.minutes:
        found += rows(minutes)
        args.out.write_text("[\n  " + ",\n  ".join(json.dumps(row) for row in found) + "\n]\n")


if __name__ == "__main__":
    main()
