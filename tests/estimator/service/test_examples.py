"""The examples are what they say: configurations load, Zenoh takes its files, the recipes name what exists."""

from pathlib import Path

import pytest
import zenoh

from estimator.config import load
from estimator.service.zenoh.config import check, session_config

EXAMPLES = Path(__file__).parents[3] / "examples"
VEHICLES = sorted([*EXAMPLES.glob("vehicle*.toml"), *EXAMPLES.glob("rigs/*.toml")])


@pytest.mark.parametrize("file", VEHICLES, ids=lambda f: f.name)
def test_configurations_load_and_open_nothing_by_accident(file: Path, tmp_path: Path) -> None:
    config = load(file)
    check(config.zenoh)
    session_config(config.zenoh, tmp_path, ["0/imu/**"], ["0/landfix/**"])
    assert config.map.origin is not None


def test_the_router_lets_in_px4_and_its_own_computer_only() -> None:
    made = zenoh.Config.from_file(EXAMPLES / "zenoh" / "router.json5")
    assert made.get_json("mode") == '"router"'
    assert '"default_permission":"deny"' in made.get_json("access_control").replace(" ", "")
    zenoh.Config.from_file(EXAMPLES / "zenoh" / "client.json5")


def test_the_service_may_compile_in_memory_and_nothing_else() -> None:
    unit = (EXAMPLES / "systemd" / "landfix.service").read_text()
    settings = dict(line.split("=", 1) for line in unit.splitlines() if "=" in line and not line.startswith("#"))
    assert settings["Type"] == "notify"
    assert "MemoryDenyWriteExecute" not in settings
    assert settings["CacheDirectory"] == settings["StateDirectory"] == "landfix"
    assert settings["Environment"].startswith("NUMBA_CACHE_DIR=/var/cache/landfix")
    assert settings["NoNewPrivileges"] == "yes"
    assert settings["ProtectSystem"] == "strict"
