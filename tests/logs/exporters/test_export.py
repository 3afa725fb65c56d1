"""Each format, opened again as its own programs do, and compared with the log's estimate and truth."""

import csv
import json
import sys
from datetime import datetime
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pyarrow.parquet as pq
import pytest
from evo.core import metrics, sync
from evo.tools import file_interface
from typer.testing import CliRunner

from estimator.cli import app
from landfix import estimate_frame
from logs.evaluation.collected import read
from logs.exporters.export import Format, export
from logs.store.reader import LogError, LogReader
from logs.store.recorder import CONFIG_ATTACHMENT, Recorder
from models.frames import Origin
from tests.logs.flight_log import EPOCH_NS, ORIGIN, Flight, rewritten, truth_at, write

KML, GPX = "{http://www.opengis.net/kml/2.2}", "{http://www.topografix.com/GPX/1/1}"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("export") / "estimate.mcap"
    write(path, Flight(duration_s=100.0))
    return path


def test_csv_holds_the_estimate_with_units_in_its_header(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "estimate.csv"
    estimate = read(log).estimate
    assert export(log, out).rows == len(estimate)
    with out.open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["t_ns"]) for row in rows] == estimate.t_ns.tolist()
    p = np.array([[float(row[name]) for name in ("east_m", "north_m", "up_m")] for row in rows])
    assert np.allclose(p, estimate.p, atol=1e-4)
    assert {row["mode"] for row in rows} == {"aided", "dead_reckoning"}
    place = Origin(*ORIGIN).to_ned(*(float(rows[50][name]) for name in ("lat_deg", "lon_deg", "alt_m")))
    assert np.allclose(place, [p[50, 1], p[50, 0], -p[50, 2]], atol=1e-3)


def test_angles_of_the_truth_are_those_of_aviation(log: Path, tmp_path: Path) -> None:
    export(log, tmp_path / "truth.csv", topic="/truth")
    with (tmp_path / "truth.csv").open() as file:
        row = list(csv.DictReader(file))[500]
    t = (int(row["t_ns"]) - EPOCH_NS) * 1e-9
    angles = [float(row[name]) for name in ("roll_deg", "pitch_deg", "heading_deg")]
    assert np.allclose(angles, [np.rad2deg(0.3), np.rad2deg(0.02), np.rad2deg(0.125 * t) + 90.0], atol=1e-3)
    v_n = truth_at(t)[1]
    assert np.allclose([float(row[f"v_{axis}_m_s"]) for axis in ("north", "east", "up")], [v_n[0], v_n[1], -v_n[2]], atol=1e-3)


def test_evo_reads_tum_and_its_error_is_that_of_evaluate(log: Path, tmp_path: Path) -> None:
    export(log, tmp_path / "estimate.tum")
    export(log, tmp_path / "truth.tum", topic="/truth")
    estimate, truth = (file_interface.read_tum_trajectory_file(tmp_path / f"{name}.tum") for name in ("estimate", "truth"))
    assert estimate.check()[0]
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data(sync.associate_trajectories(truth, estimate))
    result = json.loads(CliRunner().invoke(app, ["evaluate", str(log), "--json"]).stdout)
    assert error.get_statistic(metrics.StatisticsType.rmse) == pytest.approx(result["accuracy"]["position_m"]["rmse"], abs=1e-4)
    with (tmp_path / "estimate.tum").open() as file:
        stamps = [line.split()[0] for line in file if not line.startswith("#")]
    assert stamps[1] == f"{EPOCH_NS // 10**9}.040000000"  # to the nanosecond


def test_kml_has_a_line_for_each_stretch_of_one_mode(log: Path, tmp_path: Path) -> None:
    export(log, tmp_path / "flight.kml")
    document = ElementTree.parse(tmp_path / "flight.kml").getroot().find(f"{KML}Document")
    assert document is not None
    marks = document.findall(f"{KML}Placemark")
    assert [mark.findtext(f"{KML}name") for mark in marks] == ["aided", "dead_reckoning"] * 2 + ["aided"]
    styles = {f"#{style.get('id')}" for style in document.findall(f"{KML}Style")}
    assert {mark.findtext(f"{KML}styleUrl") for mark in marks} <= styles
    texts = [mark.findtext(f"{KML}LineString/{KML}coordinates") or "" for mark in marks]
    points = np.array([[float(x) for x in point.split(",")] for point in texts[0].split()])
    north, east, down = Origin(*ORIGIN).to_ned(points[0, 1], points[0, 0], points[0, 2])
    assert np.hypot(north - 40.0, east) < 1.0
    assert abs(down + 30.0) < 1.0
    assert texts[0].split()[-1] == texts[1].split()[0]  # no hole between two lines


def test_gpx_points_have_height_and_time_in_the_order_of_the_schema(log: Path, tmp_path: Path) -> None:
    written = export(log, tmp_path / "flight.gpx", rate_hz=1.0)
    root = ElementTree.parse(tmp_path / "flight.gpx").getroot()
    assert root.tag == f"{GPX}gpx"
    assert (root.get("version"), root.get("creator")) == ("1.1", "landfix")
    points = root.findall(f"{GPX}trk/{GPX}trkseg/{GPX}trkpt")
    assert len(points) == written.rows == 101
    assert [child.tag for child in points[0]] == [f"{GPX}ele", f"{GPX}time"]
    assert datetime.fromisoformat(points[10].findtext(f"{GPX}time") or "").timestamp() == pytest.approx(EPOCH_NS * 1e-9 + 10.0)


def test_a_gap_begins_a_new_segment(log: Path, tmp_path: Path) -> None:
    with LogReader(log) as reader, Recorder(tmp_path / "gap.mcap") as recorder:
        for r in reader:
            if r.topic != "/landfix/odometry" or not 40e9 < r.log_time_ns - EPOCH_NS < 50e9:
                recorder.write(r.topic, r.schema, r.data, r.log_time_ns)
    export(tmp_path / "gap.mcap", tmp_path / "gap.gpx")
    assert len(ElementTree.parse(tmp_path / "gap.gpx").getroot().findall(f"{GPX}trk/{GPX}trkseg")) == 2


def test_heights_on_maps_are_above_the_sea(log: Path, tmp_path: Path) -> None:
    with LogReader(log) as reader, Recorder(tmp_path / "log.mcap") as recorder:
        recorder.attach(CONFIG_ATTACHMENT, "application/toml", b"[map]\ngeoid_m = 48.0\n")
        for r in reader:
            recorder.write(r.topic, r.schema, r.data, r.log_time_ns)
    heights = []
    for source in (log, tmp_path / "log.mcap"):
        export(source, tmp_path / "a.gpx")
        point = ElementTree.parse(tmp_path / "a.gpx").getroot().find(f"{GPX}trk/{GPX}trkseg/{GPX}trkpt")
        assert point is not None
        heights.append(float(point.findtext(f"{GPX}ele") or "nan"))
    assert heights[0] - heights[1] == pytest.approx(48.0, abs=1e-3)


def test_parquet_and_the_data_frame_hold_the_same(log: Path, tmp_path: Path) -> None:
    export(log, tmp_path / "estimate.parquet", rate_hz=5.0)
    table = pq.read_table(tmp_path / "estimate.parquet")
    frame = estimate_frame(log, rate_hz=5.0)
    assert str(table.schema.field("t_ns").type) == "int64"
    assert json.loads(table.schema.metadata[b"origin_lat_lon_alt"]) == pytest.approx(ORIGIN, abs=1e-6)
    assert table.column_names == list(frame.columns)
    assert np.array_equal(table["radius95_m"].to_numpy(), frame["radius95_m"].to_numpy())
    assert frame.index[0].value == frame["t_ns"].iloc[0] == EPOCH_NS
    assert frame.index.tz is not None
    assert len(frame) == 501
    assert frame.attrs["origin"] == pytest.approx(ORIGIN, abs=1e-6)


def test_the_radius_holds_95_percent_of_the_errors(log: Path) -> None:
    frame, truth = estimate_frame(log), estimate_frame(log, topic="/truth")
    error = np.hypot(frame["east_m"] - truth["east_m"], frame["north_m"] - truth["north_m"])
    assert 0.9 < np.mean(error <= frame["radius95_m"]) <= 1.0


def test_without_pyarrow_or_pandas_one_line_reports_what_to_install(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("pandas", "pyarrow", "pyarrow.parquet"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(LogError, match=r"pip install 'landfix\[export\]'"):
        export(log, tmp_path / "estimate.parquet")
    with pytest.raises(LogError, match=r"pip install 'landfix\[export\]'"):
        estimate_frame(log)
    assert not (tmp_path / "estimate.parquet").exists()


def test_what_cannot_be_written_is_refused_in_one_line(log: Path, tmp_path: Path) -> None:
    nowhere = rewritten(log, tmp_path / "nowhere.mcap", without=("/landfix/global",))
    with pytest.raises(LogError, match="no place on Earth"):
        export(nowhere, tmp_path / "a.kml")
    with pytest.raises(LogError, match=r"give --format"):
        export(log, tmp_path / "a.xlsx")
    with pytest.raises(LogError, match="holds no /other"):
        export(log, tmp_path / "a.csv", topic="/other")
    with pytest.raises(LogError, match="is no folder"):
        export(log, tmp_path / "absent" / "a.csv")
    assert list(tmp_path.glob("a.*")) == []


def test_the_command_reports_what_it_wrote(log: Path, tmp_path: Path) -> None:
    said = CliRunner().invoke(app, ["export", str(log), "-o", str(tmp_path / "x.txt"), "--format", "tum", "--rate", "1"])
    assert said.exit_code == 0
    assert "101 rows of /landfix/odometry as tum" in said.stdout
    wrong = CliRunner().invoke(app, ["export", str(log), "-o", str(tmp_path / "x.txt"), "--format", "xls"])
    assert wrong.exit_code == 2
    assert set(Format) == {"csv", "parquet", "tum", "kml", "gpx"}
