"""Cameras for viewers: CameraInfo, and poses on the body in /tf_static.

    x_base = F (R_bk x_k + p_bk),   F = diag(1, -1, -1)  (FRD -> FLU);   R_br = R_bc R_rc^T,  p_br = p_bc - R_br t_rc

k: left or right camera (REP 103's optical frame). CameraInfo is of the raw image: K, D, R = I, P = [K | 0].
"""

from typing import Final

import numpy as np

from logs.wire import axes, schemas
from logs.wire.encoding import Encoded, header_of, packed, static_transform, whole_image
from logs.wire.schemas import STORE
from models import so3
from models.camera import CameraModel, StereoRig
from models.messages import Array, vec3

LEFT_FRAME: Final = "left_camera"
RIGHT_FRAME: Final = "right_camera"
LEFT_TOPIC: Final = "/landfix/left/camera_info"
RIGHT_TOPIC: Final = "/landfix/right/camera_info"
STATIC_TOPIC: Final = "/tf_static"
_PLUMB_BOB: Final = 5  # coefficients; more: rational_polynomial


def encode_cameras(t_ns: int, rig: StereoRig) -> list[Encoded]:
    """CameraInfo of the cameras, and a message of their transforms."""
    R_br = rig.R_bc @ rig.R_rc.T
    cameras = [(LEFT_TOPIC, LEFT_FRAME, rig.left, rig.R_bc, rig.p_bc)]
    if not rig.one_camera:
        cameras.append((RIGHT_TOPIC, RIGHT_FRAME, rig.right, R_br, rig.p_bc - R_br @ rig.t_rc))
    infos = [_camera_info(t_ns, topic, frame, camera) for topic, frame, camera, _, _ in cameras]
    transforms = [static_transform(t_ns, frame, axes.body(vec3(p)), _turn(R)) for _, frame, _, R, p in cameras]
    return [*infos, packed(STATIC_TOPIC, schemas.TF, transforms=transforms)]


def is_own_static(data: bytes) -> bool:
    """Whether it is base_link -> left_camera[, right_camera]."""
    try:
        transforms = STORE.deserialize_cdr(data, schemas.TF).transforms  # type: ignore[attr-defined]
    except Exception:  # whatever bytes from outside trip over, they are not ours
        return False
    return bool(transforms) and all(
        t.header.frame_id == "base_link" and t.child_frame_id in {LEFT_FRAME, RIGHT_FRAME} for t in transforms
    )


def _turn(R_bk: Array) -> tuple[float, float, float, float]:
    w, x, y, z = so3.from_matrix(np.diag([1.0, -1.0, -1.0]) @ R_bk).tolist()
    return w, x, y, z


def _camera_info(t_ns: int, topic: str, frame: str, camera: CameraModel) -> Encoded:
    d = np.zeros(max(_PLUMB_BOB, len(camera.distortion)))
    d[: len(camera.distortion)] = camera.distortion
    return packed(
        topic,
        schemas.CAMERA_INFO,
        header=header_of(t_ns, frame),
        height=camera.height,
        width=camera.width,
        distortion_model="plumb_bob" if len(d) == _PLUMB_BOB else "rational_polynomial",
        d=d,
        k=camera.matrix.ravel(),
        r=np.eye(3).ravel(),
        p=np.column_stack((camera.matrix, np.zeros(3))).ravel(),
        binning_x=0,
        binning_y=0,
        roi=whole_image(),
    )
