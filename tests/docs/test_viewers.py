"""The layouts for Foxglove and PlotJuggler: every topic and field that they name is in a log of ours, of the type they need."""

import dataclasses
import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimator.config import load
from estimator.frontend.files import load_processor
from estimator.frontend.replay_images import ImageReplay
from estimator.replay.replay import replay
from logs.store.reader import LogReader
from logs.store.recorder import Recorder
from logs.wire import schemas
from logs.wire.codec import encode_truth
from tests.estimator.sights import PLACE, write_flight

ROOT = Path(__file__).parents[2]
FOXGLOVE = json.loads((ROOT / "examples" / "foxglove" / "landfix.json").read_text())
PLOTJUGGLER = ET.parse(ROOT / "examples" / "plotjuggler" / "landfix.xml").getroot()
PANELS: dict[str, Any] = FOXGLOVE["configById"]
DRAWN_IN_3D = {  # that Foxglove's 3D panel draws without a plug-in
    "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped", "visualization_msgs/msg/MarkerArray",
}  # fmt: skip

Messages = dict[str, list[Any]]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short flight with images and truth, as `landfix simulate` and `landfix replay --from-images` leave it."""
    flight, config_file = write_flight(tmp_path_factory.mktemp("viewers"))
    source, out = flight.with_name("source.mcap"), flight.with_name("out.mcap")
    with LogReader(flight) as reader, Recorder(source) as recorder:
        for record in reader:
            recorder.write(record.topic, record.schema, record.data, record.log_time_ns)
            if record.topic == "/imu":
                truth = encode_truth(record.log_time_ns, PLACE, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
                recorder.write(*truth, record.log_time_ns)
    config = load(config_file)
    processor = load_processor(flight.with_name("rig.yaml"), flight.with_name("map.geojson"), config.map.origin)
    seen = ImageReplay(processor, config.vision, config.inputs.left_image, config.inputs.right_image, source)
    replay(source, out, config, processor=seen)
    return out


@pytest.fixture(scope="module")
def types(log: Path) -> dict[str, str]:
    """Topic -> type."""
    with LogReader(log) as reader:
        return {record.topic: record.schema for record in reader}


@pytest.fixture(scope="module")
def messages(log: Path) -> Messages:
    """All messages but images and the fast ones, of which the first few."""
    found: Messages = {}
    with LogReader(log) as reader:
        for record in reader:
            kept = found.setdefault(record.topic, [])
            if "image" not in record.topic and (len(kept) < 5 or "aid_status" in record.topic):
                kept.append(schemas.STORE.deserialize_cdr(record.data, record.schema))
    return found


def _panels(kind: str) -> list[dict[str, Any]]:
    found = [config for name, config in PANELS.items() if name.startswith(f"{kind}!")]
    assert found, kind
    return found


def _of_message(message: Any, path: str) -> list[Any]:
    """What .field[i] leads to, if it is there."""
    for field, index in re.findall(r"\.(\w+)|\[(\d+)\]", path):
        if field:
            message = getattr(message, field)
        elif int(index) >= len(message):
            return []
        else:
            message = message[int(index)]
    return [message]


def _foxglove_values(messages: Messages, text: str) -> list[Any]:
    """The values of a message path: /topic{field=="x"}.field[i].field."""
    match = re.fullmatch(r'(/[\w/]+)(?:\{(\w+)=="(\w+)"\})?((?:\.\w+|\[\d+\])+)', text)
    assert match, f"{text}: no message path"
    topic, field, wanted, path = match.groups()
    assert topic in messages, f"{text}: no such topic"
    chosen = [m for m in messages[topic] if field is None or getattr(m, field) == wanted]
    return [value for m in chosen for value in _of_message(m, path)]


def test_everything_laid_out_is_a_panel_and_the_other_way_round() -> None:
    def leaves(node: Any) -> Iterator[str]:
        if isinstance(node, str):
            yield node
            if node.startswith("Tab!"):
                for tab in PANELS[node]["tabs"]:
                    yield from leaves(tab["layout"])
        else:
            assert node["direction"] in {"row", "column"}
            yield from leaves(node["first"])
            yield from leaves(node["second"])

    assert sorted(leaves(FOXGLOVE["layout"])) == sorted(PANELS)


def test_the_3d_panel_draws_landmarks_and_pose_in_a_frame_that_tf_reports(types: dict[str, str], messages: Messages) -> None:
    (panel,) = _panels("3D")
    assert {"/landfix/landmarks", "/landfix/odometry"} <= {topic for topic, s in panel["topics"].items() if s["visible"]}
    for topic in panel["topics"]:
        assert types[topic] in DRAWN_IN_3D
    (transform,) = messages["/tf"][0].transforms
    assert (transform.header.frame_id, transform.child_frame_id) == (panel["fixedFrame"], panel["followTf"])
    assert messages["/landfix/landmarks"][0].markers[1].header.frame_id == panel["fixedFrame"]


def test_images_health_and_map_are_there(types: dict[str, str], messages: Messages) -> None:
    for panel in _panels("Image"):
        mode = panel["imageMode"]
        assert types[mode["imageTopic"]] in {schemas.IMAGE, schemas.COMPRESSED_IMAGE}
        assert types[mode["calibrationTopic"]] == schemas.CAMERA_INFO
        (camera, *_), (static, *_) = messages[mode["calibrationTopic"]], messages["/tf_static"]
        assert camera.header.frame_id in {t.child_frame_id for t in static.transforms}
        assert panel["topics"]["/landfix/landmarks"]["visible"]
    (health,) = _panels("DiagnosticStatusPanel")
    assert types[health["topicToRender"]] == schemas.DIAGNOSTICS
    status = messages[health["topicToRender"]][0].status[0]
    assert (status.name, status.hardware_id) == (health["selectedName"], health["selectedHardwareId"])
    (earth,) = _panels("map")
    assert types[earth["followTopic"]] == schemas.NAV_SAT_FIX


def test_plots_show_numbers_of_messages_with_a_header(messages: Messages) -> None:
    series = [s for panel in _panels("Plot") for s in panel["paths"]]
    for s in series:
        if re.fullmatch(r"[\d.]+", s["value"]):
            continue  # a line at that height
        values = _foxglove_values(messages, s["value"])
        assert values or "gnss" in s["value"], f"{s['value']}: never there"  # this flight has no GNSS
        assert all(isinstance(v, (float, int, np.floating)) for v in values), s["value"]
        topic = re.split(r"[.{]", s["value"])[0]
        assert s["timestampMethod"] == "headerStamp"
        assert messages[topic][0].header.stamp.sec > 0
    covariance = {s["value"] for s in series if ".covariance[" in s["value"]}
    assert covariance == {f"/landfix/odometry.pose.covariance[{7 * k}]" for k in range(6)}, "the diagonal"


def test_transitions_show_words(messages: Messages) -> None:
    (panel,) = _panels("StateTransitions")
    for s in panel["paths"]:
        values = _foxglove_values(messages, s["value"])
        assert values
        assert all(isinstance(v, str) and v for v in values)


def test_foxglove_has_every_setting_of_its_panels() -> None:
    """Against the panels' own description in Foxglove's SDK."""
    layouts = pytest.importorskip("foxglove.layouts", reason="foxglove-sdk is not installed (landfix[live])")
    kinds = {
        "3D": "ThreeDeeConfig", "Image": "ImageConfig", "Plot": "PlotConfig", "StateTransitions": "StateTransitionsConfig",
        "DiagnosticStatusPanel": "DiagnosticsDetailConfig", "map": "MapConfig",
    }  # fmt: skip

    def names(kind: str) -> set[str]:
        fields = dataclasses.fields(getattr(layouts, kind))
        return {re.sub(r"_(\w)", lambda m: m[1].upper(), field.name) for field in fields}

    for name, config in PANELS.items():
        kind = name.partition("!")[0]
        if kind == "Tab":
            continue
        assert set(config) - {"foxglovePanelTitle"} <= names(kinds[kind]), name
        for s in config.get("paths", ()):
            assert set(s) <= names("PlotSeries" if kind == "Plot" else "StateTransitionsSeries"), name
    (scene,) = _panels("3D")
    assert set(scene["topics"]["/landfix/odometry"]) <= names("BaseRendererPoseTopicSettings") | {"visible"}
    assert set(scene["cameraState"]) <= names("ThreeDeeCameraState")


def _plotjuggler_names(topic: str, message: Any) -> Iterator[str]:
    """The series that PlotJuggler makes of a message: fields by /, arrays by [i], covariances of poses and twists by /[i;j]."""
    if hasattr(message, "status") and isinstance(message.status, list):
        yield from (f"{topic}/{s.name}/{pair.key}" for s in message.status for pair in s.values if _is_number(pair.value))
        return

    def walk(prefix: str, value: Any) -> Iterator[str]:
        if hasattr(value, "__msgtype__"):
            for field in dataclasses.fields(value):
                if field.name != "__msgtype__":
                    yield from walk(f"{prefix}/{field.name}", getattr(value, field.name))
        elif isinstance(value, np.ndarray) and prefix.endswith(("pose/covariance", "twist/covariance")):
            yield from (f"{prefix}/[{i};{j}]" for i in range(6) for j in range(i, 6))
        elif isinstance(value, (np.ndarray, list)):
            for k, item in enumerate(value):
                yield from walk(f"{prefix}[{k}]", item)
        elif not isinstance(value, str):
            yield prefix

    yield from walk(topic, message)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def test_every_curve_of_plotjuggler_is_a_series_of_the_log(messages: Messages) -> None:
    series = {name for topic, some in messages.items() for message in some for name in _plotjuggler_names(topic, message)}
    curves = [curve.attrib["name"] for curve in PLOTJUGGLER.iter("curve")]
    assert len(curves) == len(set(curves)) > 15
    assert set(curves) <= series
    for splitter in PLOTJUGGLER.iter("DockSplitter"):
        assert int(splitter.attrib["count"]) == len(splitter) == len(splitter.attrib["sizes"].split(";"))
