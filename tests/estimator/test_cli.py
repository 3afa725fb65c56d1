import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner, Result

from estimator.cli import app
from estimator.replay import simulate as simulated
from estimator.service.log.recovery import is_torn
from logs.importers import kind_of
from logs.store.reader import LogReader
from models.sim.scenario import simulate
from models.sim.scenario_file import loads

ROOT = Path(__file__).parents[2]
COMMANDS = ["demo", "replay", "evaluate", "report", "export", "forecast", "simulate", "import", "recover", "doctor", "calibrate"]


def run(*args: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in args])


def fails(*args: object) -> str:
    """The one line on stderr of a command that fails."""
    result = run(*args)
    assert result.exit_code == 1
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("landfix: ")
    assert "internal error" not in result.stderr
    return result.stderr.removeprefix("landfix: ").strip()


@pytest.fixture(scope="module")
def estimate(flight: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("cli") / "estimate.mcap"
    assert run("replay", flight, "-o", out, "-c", flight.with_suffix(".toml")).exit_code == 0
    return out


def test_help_lists_all_commands_and_each_has_examples() -> None:
    text = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "80"}).output
    assert re.findall(r"^(\w+):$", text, re.MULTILINE) == ["Options", "Fly", "Logs", "Maps", "Photos", "Calibration", "More"]
    assert max(map(len, text.splitlines())) <= 80
    for command in COMMANDS:
        assert f"\n  {command} " in text
        helped = run(command, "--help")
        assert helped.exit_code == 0
        assert f"  landfix {command}" in helped.output


def test_help_imports_nothing_heavy() -> None:
    code = "import sys, estimator.cli; print(*{m.partition('.')[0] for m in sys.modules})"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT).stdout.split()
    assert not {"numpy", "numba", "scipy", "mcap", "matplotlib", "rosbags"} & set(loaded)


@pytest.mark.parametrize(
    "args", [["nope"], ["replay", "in.mcap"], ["simulate", "s.toml", "-o", "x", "--seed", "-1"], ["doctor", "--config", "x"]]
)
def test_wrong_usage_exits_with_2(args: list[str]) -> None:
    result = run(*args)
    assert result.exit_code == 2
    assert "Traceback" not in result.output


def test_replay_prints_a_summary_or_json(flight: Path, tmp_path: Path) -> None:
    config = flight.with_suffix(".toml")
    text = run("replay", flight, "-o", tmp_path / "a.mcap", "-c", config)
    assert text.exit_code == 0
    assert "x real time" in text.stdout
    assert "/pose_fix" in text.stdout
    summary = json.loads(run("replay", flight, "-o", tmp_path / "b.mcap", "-c", config, "--from-fixes", "--json").stdout)
    assert summary["internal_errors"] == 0
    assert summary["imu_samples"] == 4001
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_replay_reports_when_the_first_estimate_came_or_what_it_waits_for(flight: Path, tmp_path: Path) -> None:
    text = run("replay", flight, "-o", tmp_path / "a.mcap", "-c", flight.with_suffix(".toml")).stdout
    assert re.search(r"first estimate +\d+\.\d s after the log's first message", text)
    blind = tmp_path / "blind.toml"
    blind.write_text("[inputs]\ngnss = []\ngnss_velocity = []\npose_fix = []\n")
    text = run("replay", flight, "-o", tmp_path / "b.mcap", "-c", blind).stdout
    assert re.search(r"first estimate +none: waiting for a position", text)


def test_a_torn_log_is_replayed_and_said_to_be_torn(flight: Path, tmp_path: Path) -> None:
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(flight.read_bytes()[: flight.stat().st_size // 3])
    result = run("replay", torn, "-o", tmp_path / "out.mcap", "-c", flight.with_suffix(".toml"))
    assert result.exit_code == 0
    assert "is truncated; replayed up to its last whole record" in result.stderr


def test_evaluate_reports_the_error_and_json_is_whole(estimate: Path) -> None:
    assert "position" in run("evaluate", estimate).stdout
    evaluation = json.loads(run("evaluate", estimate, "--json").stdout)
    assert 0.0 < evaluation["accuracy"]["position_m"]["rmse"] < 3.0
    assert "/nowhere" in fails("evaluate", estimate, "--truth", "/nowhere")


def test_simulate_writes_a_log_and_its_configuration(tmp_path: Path) -> None:
    scenario, out = tmp_path / "s.toml", tmp_path / "out.mcap"
    scenario.write_text("duration_s = 2.0\n[pose_fix]\n")
    written = json.loads(run("simulate", scenario, "-o", out, "--seed", 3, "--json").stdout)
    assert written["messages"] > 800
    first = out.read_bytes()
    run("simulate", scenario, "-o", out, "--seed", 3)
    assert out.read_bytes() == first
    assert run("replay", out, "-o", tmp_path / "est.mcap", "-c", tmp_path / "out.toml").exit_code == 0
    scenario.write_text("duration = 2.0\n")
    assert "did you mean 'duration_s'?" in fails("simulate", scenario, "-o", out)


def test_import_csv(tmp_path: Path) -> None:
    rows = [f"{k * 0.01:.2f},0,0,0,0,0,-9.81" for k in range(300)]
    (tmp_path / "imu.csv").write_text("t_s,gx,gy,gz,fx,fy,fz\n" + "\n".join(rows) + "\n")
    out = tmp_path / "out.mcap"
    assert json.loads(run("import", "csv", tmp_path, "-o", out, "--json").stdout)["messages"] == {"/imu": 300}
    alone = run("replay", out, "-o", tmp_path / "est.mcap", "-c", out.with_suffix(".toml"))
    assert alone.exit_code == 1
    assert "/imu since 0.0 s: the gyroscope is exactly 0" in alone.stderr
    assert alone.stderr.splitlines()[-1].startswith("landfix: no estimate: no GNSS or pose fix in the log")


@pytest.mark.parametrize(
    ("names", "kind"),
    [
        (["171.BIN"], "dataflash"), (["a.ulg"], "ulog"), (["a.tlog"], "tlog"), (["a.bag"], "rosbag"), (["a.mcap"], "rosbag"),
        (["d/imu.csv.gz", "d/gps.csv"], "csv"), (["d/mav0/x"], "euroc"), (["d/metadata.yaml", "d/a_0.db3"], "rosbag"),
        (["d/1.bag", "d/2.bag"], "rosbag"),
    ],
)  # fmt: skip
def test_the_kind_of_a_recording_is_found(tmp_path: Path, names: list[str], kind: str) -> None:
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    assert kind_of(tmp_path / names[0].partition("/")[0]) == kind


def test_import_without_a_kind_writes_a_log_of_that_name_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "flight_dir").mkdir()
    rows = "".join(f"{0.01 * k},0,0,0,0,0,-9.8\n" for k in range(300))
    (tmp_path / "flight_dir" / "imu.csv").write_text(f"t_s,gx,gy,gz,fx,fy,fz\n{rows}")
    monkeypatch.chdir(tmp_path)
    assert run("import", "flight_dir").exit_code == 0
    assert (tmp_path / "flight_dir.mcap").is_file()
    (tmp_path / "empty").mkdir()
    assert "its kind does not show" in fails("import", "empty")


@pytest.mark.parametrize(
    "args", [["demo", "--seed", "x"], ["tune", "a.mcap", "-o", "b", "--jobs", "x"], ["import", "a", "b", "c"]]
)
def test_usage_errors_have_no_words_of_a_library(args: list[str]) -> None:
    done = run(*args)
    assert done.exit_code == 2
    assert not re.search("Value error|Input should|parse string", done.stderr)


@pytest.mark.parametrize("args", [["replay"], ["forecast"], ["import"], ["live"], ["map", "build"], ["fleet", "run"]])
def test_help_has_no_types_of_python(args: list[str]) -> None:
    assert re.findall(r"list\[| range>|<str|[{}]|\[\[", run(*args, "--help").stdout) == []


@pytest.mark.parametrize("group", [[], ["map"], ["fleet"], ["calibrate"], ["bench"]])
def test_no_line_of_the_help_is_cut(group: list[str]) -> None:
    listed = run(*group, "--help").stdout.partition("Options:")[2]
    assert [line for line in listed.splitlines() if line.endswith("...")] == []


def test_recover(flight: Path, tmp_path: Path) -> None:
    torn, whole = tmp_path / "torn.mcap", tmp_path / "whole.mcap"
    torn.write_bytes(flight.read_bytes()[: flight.stat().st_size // 2])
    assert json.loads(run("recover", torn, "-o", whole, "--json").stdout)["torn"]
    assert "torn" not in run("replay", whole, "-o", tmp_path / "out.mcap").stderr


def test_every_failure_is_one_line(flight: Path, tmp_path: Path) -> None:
    text, out, config = tmp_path / "no.mcap", tmp_path / "out.mcap", tmp_path / "v.toml"
    text.write_text("this is no log")
    config.write_text("[imu]\naxis = 'flu'\n")
    assert "no.mcap" in fails("replay", text, "-o", out)
    assert "nowhere.mcap" in fails("replay", tmp_path / "nowhere.mcap", "-o", out)
    assert "did you mean 'axes'?" in fails("replay", flight, "-o", out, "-c", config)
    assert "would overwrite the input" in fails("replay", flight, "-o", flight)
    assert "cannot be written" in fails("replay", flight, "-o", tmp_path / "no" / "folder" / "out.mcap")
    assert "no.mcap" in fails("evaluate", text)
    assert "no.mcap" in fails("recover", text, "-o", out)
    assert "landfix replay" in fails("evaluate", flight)
    assert "nowhere" in fails("import", "csv", tmp_path / "nowhere", "-o", out)
    assert "nowhere.toml" in fails("simulate", tmp_path / "nowhere.toml", "-o", out)
    assert "\x1b" not in fails("replay", tmp_path / "\x1b[2J.mcap", "-o", out)  # a name is no command to the terminal


def test_a_defect_of_ours_is_one_line_too_and_debug_shows_it(
    monkeypatch: pytest.MonkeyPatch, flight: Path, tmp_path: Path
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise KeyError("oops")

    monkeypatch.delenv("LANDFIX_DEBUG", raising=False)
    monkeypatch.setattr("estimator.replay.replay.replay", broken)
    result = run("replay", flight, "-o", tmp_path / "out.mcap")
    assert result.exit_code == 1
    assert result.stderr == "landfix: internal error, please report it: KeyError: 'oops' (LANDFIX_DEBUG=1 shows where)\n"
    monkeypatch.setenv("LANDFIX_DEBUG", "1")
    assert isinstance(run("replay", flight, "-o", tmp_path / "out.mcap").exception, KeyError)


BEGINS = """
from estimator.cli import one_line
try:
    import numpy as np
    from models.so3 import normalise
    normalise(np.ones(4))
except Exception as error:
    print(one_line(error))
"""


@pytest.mark.parametrize(
    ("name", "value", "remedy"),
    [
        ("NUMBA_NUM_THREADS", "0", "Number of threads specified must be > 0.: unset or correct NUMBA_NUM_THREADS=0"),
        ("NUMBA_CACHE_DIR", "cache", "free its disk, or set NUMBA_CACHE_DIR to a folder that can be written"),
    ],
)
def test_an_environment_in_which_nothing_can_run_is_one_line_with_its_remedy(
    name: str, value: str, remedy: str, tmp_path: Path
) -> None:
    done = subprocess.run(
        ["prlimit", "--fsize=100", sys.executable, "-c", BEGINS],
        capture_output=True, text=True, check=True, cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT), name: value},
    )  # fmt: skip
    assert done.stdout.endswith(f"{remedy}\n")


def test_the_program_as_a_person_starts_it(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "estimator", "replay", str(tmp_path / "no.mcap"), "-o", "x.mcap"],
        capture_output=True, text=True, check=False, cwd=ROOT,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr == f"landfix: {tmp_path / 'no.mcap'}: no such file or directory\n"
    version = subprocess.run(
        [sys.executable, "-m", "estimator", "--version"],
        capture_output=True, text=True, check=True, cwd=ROOT,
    )  # fmt: skip
    assert version.stdout.startswith("landfix ")


@pytest.mark.parametrize("every", [True, False])
def test_the_table_of_keys_is_a_valid_configuration_with_the_defaults(*, every: bool, tmp_path: Path) -> None:
    words = ["doctor", "--config", *(["--all"] if every else [])]
    printed = run(*words).stdout
    assert "# m: antenna from the IMU" in printed
    assert every or printed.count("\n") < 70, "more than a screen"
    (tmp_path / "all.toml").write_text(printed)
    from estimator import strict_toml  # noqa: PLC0415  (the program imports these late, too)
    from estimator.commands.doctor import _BASIC  # noqa: PLC0415
    from estimator.config import Config, load  # noqa: PLC0415

    assert load(tmp_path / "all.toml") == Config()
    rows = json.loads(run(*words, "--json").stdout)
    assert {"section": "map", "name": "geoid_m", "default": "0.0", "unit": "m"}.items() <= next(
        r for r in rows if r["name"] == "geoid_m"
    ).items()
    known = {(key.section, key.name) for key in strict_toml.keys(Config)}
    shown = {(row["section"], row["name"]) for row in rows}
    assert shown == (known if every else {(section, name) for section, names in _BASIC.items() for name in names.split()})
    assert shown <= known


def test_evaluate_compares_several_logs_and_goes_on_where_one_is_none(estimate: Path, flight: Path) -> None:
    assert run("evaluate", estimate, estimate).stdout.count("estimate") >= 2
    both = run("evaluate", estimate, flight, "--csv")
    assert both.exit_code == 1
    assert both.stdout.count("\n") == 2
    assert "holds no /landfix/odometry" in both.stderr
    assert len(json.loads(run("evaluate", estimate, estimate, "--json").stdout)) == 2
    assert run("evaluate", estimate, "--markdown").stdout.startswith("| run | s |")
    assert run("evaluate", estimate, "--csv", "--json").exit_code == 2


def test_report_writes_a_page_and_reports_what_is_on_it(estimate: Path, flight: Path, tmp_path: Path) -> None:
    out = tmp_path / "report.html"
    text = run("report", estimate, "-o", out).stdout
    assert text.startswith(f"{estimate}: ")
    assert "inside the reported 95 % radius" in text
    assert f"report: {out}" in text
    assert "gyroscope bias" in out.read_text()
    written = json.loads(run("report", estimate, "-o", out, "--no-pictures", "--json").stdout)
    assert written["size"] == out.stat().st_size
    assert "holds no /landfix/odometry" in fails("report", flight, "-o", out)
    assert "no_map.geojson" in fails("report", estimate, "-o", out, "--rig", "no_such_rig.yaml", "--map", "no_map.geojson")


def _interrupted(flight: Path, out: Path) -> tuple[int, str]:
    """Exit code and stderr of a replay that gets Ctrl-C once it has written something."""
    with subprocess.Popen(
        [sys.executable, "-m", "estimator", "replay", str(flight), "-o", str(out)], stderr=subprocess.PIPE, text=True, cwd=ROOT
    ) as process:
        end = time.monotonic() + 120.0
        while not (out.exists() and out.stat().st_size > 30_000) and process.poll() is None and time.monotonic() < end:
            time.sleep(0.001)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=120)
    return process.returncode, said


def test_ctrl_c_keeps_what_is_written_and_reports_it_in_one_line(tmp_path: Path) -> None:
    flight = tmp_path / "flight.mcap"
    simulation = simulate(loads("duration_s = 200.0\n[pose_fix]\nrate_hz = 2.0\n"), seed=1)  # seconds of work
    simulated.write(simulation, flight)
    flight.with_suffix(".toml").write_text(simulation.config_toml)
    for attempt in range(5):  # on a busy machine the replay may have ended before the signal comes
        out = tmp_path / f"estimate{attempt}.mcap"
        code, said = _interrupted(flight, out)
        if code == 130:
            break
    assert code == 130
    assert (
        said
        == f"landfix: interrupted; kept: {out} ({out.stat().st_size / 1e6:.1f} MB); the last one ends where it was interrupted\n"
    )
    with LogReader(out) as kept, LogReader(flight) as whole:
        assert 0 < sum(r.topic == "/imu" for r in kept) < sum(r.topic == "/imu" for r in whole)
        assert not kept.torn
    assert not is_torn(out)


def test_the_help_lists_every_command_once_in_its_panel() -> None:
    """A command without a panel would be missing from `landfix --help`."""
    group = typer.main.get_command(app)
    text = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "110"}).output
    listed = re.findall(r"^  ([a-z]+)  +\S", text[text.index("Fly:") :], re.MULTILINE)
    assert sorted(listed) == sorted(name for name, command in group.commands.items() if not command.hidden)  # type: ignore[attr-defined]
