"""What every test may use: one thread, no display, Ctrl-C, hypothesis profiles, the folder of recorded flights."""

import gc
import os
import signal
from pathlib import Path

os.environ["MPLBACKEND"] = "Agg"  # before anything imports matplotlib
os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy: another test runs on the other core
os.environ["OPENCV_FOR_THREADS_NUM"] = "1"

import pytest
from hypothesis import settings

ROOT = Path(__file__).parents[1]

# A shell that starts the suite in the background lets it, and each of its children, ignore SIGINT. A person's terminal does not.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# No deadline: a kernel compiles at its first call.
settings.register_profile("dev", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") else "dev")


def pytest_collection_finish() -> None:
    """What is imported by now stays: the collector of garbage passes over it, and comes less often (5 % of a flight's time)."""
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


@pytest.fixture(scope="session")
def landfix_data() -> Path:
    """Folder of the recorded flights (flights/, images/, native_logs/); the test is skipped where it is absent."""
    folder = Path(os.environ.get("LANDFIX_DATA") or ROOT / "../shared/data").resolve()
    if not (folder / "flights").is_dir():
        pytest.skip("no recorded flights: set LANDFIX_DATA to the folder that holds flights/ (default ../shared/data)")
    return folder
