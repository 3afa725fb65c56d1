"""Writes ros2/landfix_msgs, the ROS 2 package of our message types, from their one definition:  python -m docs.ros2_package"""

import re
import tomllib
from pathlib import Path
from typing import Final

from logs.wire.schemas import LANDFIX_MSGS

ROOT: Final = Path(__file__).parents[1]
OUT: Final = ROOT / "ros2" / "landfix_msgs"
_WRITTEN: Final = "written by python -m docs.ros2_package from logs/wire/schemas.py"


def files() -> dict[str, str]:
    """The package: path in it -> text."""
    messages = {f"msg/{name.rpartition('/')[2]}.msg": text for name, text in sorted(LANDFIX_MSGS.items())}
    return {"package.xml": _manifest(), "CMakeLists.txt": _build(list(messages)), **messages}


def dependencies() -> list[str]:
    """Packages whose types our messages use."""
    named = (re.findall(r"^(\w+)/\w+(?:\[\d*\])? \w", text, re.MULTILINE) for text in LANDFIX_MSGS.values())
    return sorted({package for found in named for package in found} - {"landfix_msgs"})


def _manifest() -> str:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    depend = "".join(f"  <depend>{package}</depend>\n" for package in dependencies())
    return f"""\
<?xml version="1.0"?>
<!-- {_WRITTEN} -->
<package format="3">
  <name>landfix_msgs</name>
  <version>{version}</version>
  <description>Messages of landfix: landmark fixes, odometry increments, decisions on measurements, resets.</description>
  <maintainer email="landfix@example.com">landfix</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
{depend}  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
"""


def _build(messages: list[str]) -> str:
    packages = dependencies()
    found = "".join(f"find_package({package} REQUIRED)\n" for package in packages)
    listed = "".join(f'  "{message}"\n' for message in messages)
    return f"""\
# {_WRITTEN}
cmake_minimum_required(VERSION 3.8)
project(landfix_msgs)

find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
{found}
rosidl_generate_interfaces(${{PROJECT_NAME}}
{listed}  DEPENDENCIES {" ".join(packages)}
)

ament_export_dependencies(rosidl_default_runtime)
ament_package()
"""


def main() -> None:
    """Write the package anew."""
    wanted = files()
    for old in OUT.rglob("*"):
        if old.is_file() and old.relative_to(OUT).as_posix() not in wanted:
            old.unlink()
    for name, text in wanted.items():
        (OUT / name).parent.mkdir(parents=True, exist_ok=True)
        (OUT / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
