"""--mount: where a camera sits on the body."""

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from calib.files.formats import BodyPose

Mount = Annotated[
    str,
    typer.Option(
        "--mount", metavar="X,Y,Z,ROLL,PITCH,YAW", help="(Left) camera on the body: m forward, right, down of the IMU; deg."
    ),
]
MountSigma = Annotated[str, typer.Option("--mount-sigma", metavar="M,DEG", help="Standard deviation of --mount, each axis.")]


def mount_of(place: str, sigma: str) -> "BodyPose | None":
    """R_bc = R(roll, pitch, yaw) FORWARD, or None. Raises BadParameter."""
    import numpy as np

    from calib.files.formats import BodyPose
    from calib.files.rig_yaml import FORWARD
    from models import so3

    if not place:
        return None
    try:
        numbers, spread = np.array([float(x) for x in place.split(",")]), np.array([float(x) for x in sigma.split(",")])
    except ValueError:
        numbers, spread = np.zeros(1), np.zeros(1)
    if numbers.shape != (6,) or spread.shape != (2,) or not (np.isfinite(numbers).all() and np.isfinite(spread).all()):
        spread = np.zeros(1)
    if not (spread > 0.0).all():
        raise typer.BadParameter("needed: --mount x,y,z,roll,pitch,yaw in m and deg, --mount-sigma m,deg", param_hint="--mount")
    R_bc = so3.matrix(so3.from_euler(*np.deg2rad(numbers[3:]))) @ FORWARD
    return BodyPose(R_bc, numbers[:3], np.diag(np.repeat(np.array([spread[0], np.deg2rad(spread[1])]) ** 2, 3)))
