"""The ROS 2 package is the definition of the messages; the subscriber of docs/ros2.md reads what is published over Zenoh."""

import json
import re
import subprocess
import sys
import threading
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from docs.ros2_package import OUT, dependencies, files
from estimator.service.zenoh.keys import rmw_key
from logs.wire import cdr_fast, schemas
from tests.estimator.service.flying import free_port

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "ros2.md"


def test_the_package_is_what_the_definition_gives() -> None:
    there = {p.relative_to(OUT).as_posix(): p.read_text(encoding="utf-8") for p in OUT.rglob("*") if p.is_file()}
    assert there == files(), "python -m docs.ros2_package"


def test_the_files_give_the_type_hashes_of_log_and_keys() -> None:
    """As ROS 2 would compute them, from the files alone and the standard types."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for path in sorted((OUT / "msg").glob("*.msg")):
        store.register(get_types_from_msg(path.read_text(encoding="utf-8"), f"landfix_msgs/msg/{path.stem}"))
    for name in schemas.LANDFIX_MSGS:
        assert store.hash_rihs01(name) == schemas.type_hash(name)


def test_the_manifest_names_every_package_that_a_message_uses() -> None:
    root = ElementTree.parse(OUT / "package.xml").getroot()
    assert (root.tag, root.get("format"), root.findtext("name")) == ("package", "3", "landfix_msgs")
    assert [e.text for e in root.findall("depend")] == dependencies()
    used = {t.partition("/")[0] for text in schemas.LANDFIX_MSGS.values() for t in re.findall(r"^(\w+/\w+)", text, re.MULTILINE)}
    assert used == set(dependencies())


def test_field_names_are_those_that_ros_2_allows() -> None:
    """Lower case, no underscore at the end or twice in a row (ROS 2 interface definition)."""
    for text in schemas.LANDFIX_MSGS.values():
        for line in text.splitlines():
            if line and not line.startswith("#"):
                name = line.split()[1]
                assert re.fullmatch(r"[a-z](?:_?[a-z0-9]+)*", name), name


def test_the_subscriber_of_the_page_prints_what_is_published(tmp_path: Path) -> None:
    (script,) = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    assert len([line for line in script.splitlines() if line.strip()]) <= 14
    config = zenoh.Config()
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    key = rmw_key(0, "/landfix/odometry", schemas.ODOMETRY, schemas.type_hash(schemas.ODOMETRY))
    (tmp_path / "script.py").write_text(script.replace("tcp/127.0.0.1:7447", endpoint))
    pipe = subprocess.PIPE
    with (
        zenoh.open(config) as session,
        subprocess.Popen([sys.executable, "script.py"], cwd=tmp_path, text=True, stdin=pipe, stdout=pipe) as child,
    ):
        assert child.stdin
        assert child.stdout
        limit = threading.Timer(60.0, child.kill)  # no test waits for ever
        limit.start()
        assert child.stdout.readline() == "Enter ends it\n"
        publishing = threading.Event()
        thread = threading.Thread(target=_publish, args=(session, key, publishing))
        thread.start()
        line = child.stdout.readline()
        publishing.set()
        thread.join()
        child.stdin.write("\n")
        child.stdin.close()
        child.stdout.read()
        code = child.wait()
        limit.cancel()
    assert (line, code) == ("12.000000034  east 1.50 m  north 2.50 m  up 3.50 m\n", 0)


def _publish(session: zenoh.Session, key: str, done: threading.Event) -> None:
    """Again and again: the first may come before the subscriber is known."""
    values = np.zeros(85)
    values[:3], values[6] = (1.5, 2.5, 3.5), 1.0
    while not done.wait(0.1):
        session.put(key, cdr_fast.odometry(12_000_000_034, values))
