"""landfix calibrate."""

import typer

from estimator.commands.calibrate import cameras, imu
from estimator.commands.common.groups import Group

_HELP = """Calibrate cameras, stereo rigs and IMUs from recordings: with standard deviations, a report and a verdict.

\b
Examples, in the order a new vehicle needs them:
  landfix calibrate stereo --left 'L*.jpg' --right 'R*.jpg' --board 9x6 --square-mm 25 -o rig.yaml
  landfix calibrate imu still.mcap -o imu.toml
  landfix calibrate camera-imu moving.mcap --rig rig.yaml -o vehicle_rig.yaml -c imu.toml
"""

app = typer.Typer(cls=Group, no_args_is_help=True, rich_markup_mode=None, add_completion=False, help=_HELP)
app.command("mono")(cameras.mono_command)
app.command("stereo")(cameras.stereo_command)
app.command("camera-imu")(imu.camera_imu_command)
app.command("imu")(imu.imu_command)
app.command("dlt")(cameras.dlt_command)
app.command("convert")(cameras.convert_command)
