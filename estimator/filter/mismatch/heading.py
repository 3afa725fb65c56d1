"""The headings of a source of poses are off by psi, a constant of it (score.py): magnetic north, or the mounting of its camera.

    R_nb(z) = exp(psi e_z) R_nb,     position  J = 0     attitude  J = e_z

A filter aligned with this source alone has its heading.
"""

import math

import numpy as np

from estimator.filter.mismatch.score import Constant
from models import so3
from models.measurements import Measurement, Pose
from models.messages import Array
from models.state import E, X

_E_Z = np.array([0.0, 0.0, 1.0])
_J = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def _jacobian(z: Measurement, _x: Array, _u: Array) -> Array | None:
    return _J if isinstance(z, Pose) and int(z.rows[-1]) == len(_J) - 1 else None


def _follows(x: Array, _u: Array) -> Array:
    moved = np.zeros(E.SIZE)
    moved[E.THETA] = -(so3.matrix(x[X.Q]).T @ _E_Z)
    return moved


def _says(topic: str, psi: float, sigma: float) -> str:
    side = "right" if psi >= 0.0 else "left"
    off, sigma = math.degrees(abs(psi)), math.degrees(sigma)
    return (
        f"headings of {topic} are {off:.1f} deg to the {side} of the motion's (sigma {sigma:.1f} deg): true north, and mountings?"
    )


HEADING = Constant("heading", math.radians(30.0), math.radians(0.02) ** 2, math.radians(2.0), math.pi, _jacobian, _follows, _says)
