"""Wire types: ROS 2 Humble's and landfix_msgs, defined here.

A schema: ros2msg text with dependencies, RIHS01 hash (REP-2011).
"""

from functools import cache
from typing import Final

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

HEADER: Final = "std_msgs/msg/Header"
IMU: Final = "sensor_msgs/msg/Imu"
NAV_SAT_FIX: Final = "sensor_msgs/msg/NavSatFix"
TWIST: Final = "geometry_msgs/msg/TwistWithCovarianceStamped"
POSE_FIX: Final = "geometry_msgs/msg/PoseWithCovarianceStamped"
PRESSURE: Final = "sensor_msgs/msg/FluidPressure"
RANGE: Final = "sensor_msgs/msg/Range"
MAGNETIC_FIELD: Final = "sensor_msgs/msg/MagneticField"
ODOMETRY: Final = "nav_msgs/msg/Odometry"
POSE: Final = "geometry_msgs/msg/PoseStamped"
TF: Final = "tf2_msgs/msg/TFMessage"
DIAGNOSTICS: Final = "diagnostic_msgs/msg/DiagnosticArray"
IMAGE: Final = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE: Final = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO: Final = "sensor_msgs/msg/CameraInfo"
LANDMARK_FIX: Final = "landfix_msgs/msg/LandmarkFix"
ODOMETRY_DELTA: Final = "landfix_msgs/msg/OdometryDelta"
AID_STATUS: Final = "landfix_msgs/msg/AidStatus"
VISION_REPORT: Final = "landfix_msgs/msg/VisionReport"
VISION_REQUEST: Final = "landfix_msgs/msg/VisionRequest"
ODOMETRY_REQUEST: Final = "landfix_msgs/msg/OdometryRequest"
RESET: Final = "landfix_msgs/msg/Reset"
INTEGRITY: Final = "landfix_msgs/msg/Integrity"
CHECKPOINT: Final = "landfix_msgs/msg/Checkpoint"

EXTENDED_STATE: Final = "mavros_msgs/msg/ExtendedState"
ISAAC_STATUS: Final = "isaac_ros_visual_slam_interfaces/msg/VisualSlamStatus"
ZED_STATUS: Final = "zed_msgs/msg/PosTrackStatus"
LOST_VARIANCE: Final = 9999.0  # of each component of an Odometry without a pose, as RTAB-Map sends it

LANDFIX_MSGS: Final = {
    LANDMARK_FIX: """\
# A 6-DoF position fix from known landmarks in a stereo pair.
# header.stamp: exposure of the pair; header.frame_id: map (ENU at the map origin).
std_msgs/Header header
# Pose of base_link (FLU) in map. Covariance: x y z rx ry rz, m^2 and rad^2; the rotation part is the error about the axes
# of map. A variance >= 9e4 m^2 or >= 10 rad^2, NaN or negative: not given.
geometry_msgs/PoseWithCovariance pose
# The part of the error that repeats from fix to fix (map, rig), in addition to pose.covariance. All zero: none known.
float64[36] covariance_common
# Identifiers of the landmarks in the map.
string[] landmarks
# Agreement of description and image, 0 to 1.
float64 similarity
# RMS of the outline fit, px.
float64 residual_px
# What makes up covariance_common, where it is known. How the pose is moved by the errors of each landmark, each of variance 1 and
# its own: for each landmark 6 rows (x y z rx ry rz) of as many columns as it has errors.
float64[] landmark_errors
# The rest, which is the rig's.
float64[36] covariance_rig
# The combinations of pose error (x y z rx ry rz, in map) that were measured: rows of six, orthonormal where a radian counts as
# 50 m; empty: the pose itself was. What they read, from the pose above, m; it then is the optimum of the prior and
# what was seen, and the covariances count for what the rows let through.
float64[] directions
float64[] readings
""",
    ODOMETRY_DELTA: """\
# How the body moved between two times, as cameras or wheels measured it.
# header.stamp: the end; header.frame_id: base_link.
std_msgs/Header header
builtin_interfaces/Time begin
# Pose of base_link (FLU) at the end, in base_link at the beginning. Covariance: x y z rx ry rz, m^2 and rad^2, of what is new in
# each increment; the rotation part is the error about the axes of base_link at the end, R_true = R exp(theta). A variance that is
# >= 9e4 m^2 or >= 10 rad^2, NaN or negative: not given.
geometry_msgs/PoseWithCovariance motion
# How the motion is moved by k errors of variance 1 that stay with the rig, such as a disparity bias: 6 rows of k; empty: a scale.
float64[] systematic
# Another number: what is known of those errors no longer holds.
uint32 epoch
""",
    AID_STATUS: """\
# What became of one measurement; sent again with a higher revision when the decision changes.
# header.stamp: validity of the measurement; header.frame_id: empty.
std_msgs/Header header
builtin_interfaces/Time arrived
# Where it came from, and what it is (gnss, pose, ...).
string topic
string kind
# fused, gated, too_old, not_finite, not_psd, stopped, ...
string reason
uint32 revision
# Of the given components, in the measurement's own units and axes (NED, FRD); of a fix in part, metres along its directions.
float64[] innovation
float64[] innovation_sigma
# Squared Mahalanobis distance / gate: <= 1 passes.
float64 test_ratio
# Arrival - validity, s.
float64 delay_s
# IMU samples processed again for it.
uint32 replayed
string detail
""",
    VISION_REPORT: """\
# Why one stereo pair gave a fix, or why not.
# header.stamp: exposure of the pair; header.frame_id: camera.
std_msgs/Header header
# fixed, or the stage that ended it: no_region, no_candidate, ambiguous, no_pose, ...
string outcome
string detail
# Regions found, and how many were similar enough to a landmark.
uint32 regions
uint32 candidates
# Best landmark of each candidate, and its similarity, 0 to 1.
string[] landmarks
float64[] similarities
# RMS of the outline fit, px; NaN without a fit.
float64 residual_px
float64 processing_s
""",
    VISION_REQUEST: """\
# Look for landmarks in these images. What vision answers follows from this, the images and the requests before it.
# header.stamp: exposure; header.frame_id: map (ENU at the map origin).
std_msgs/Header header
# The estimated pose of base_link (FLU) then, with the covariance of LandmarkFix.
geometry_msgs/PoseWithCovariance pose
# Topic and stamp of the image of each camera; an empty topic: there is none.
string left_topic
builtin_interfaces/Time left_stamp
string right_topic
builtin_interfaces/Time right_stamp
# Counts the runs of vision: each begins without memory of earlier images.
uint32 run
""",
    ODOMETRY_REQUEST: """\
# Measure the motion between two pairs of images. The answer follows from this and the images alone.
# header.stamp: exposure of the later pair; header.frame_id: base_link.
std_msgs/Header header
builtin_interfaces/Time begin
# The predicted motion, as in OdometryDelta.
geometry_msgs/PoseWithCovariance motion
# Topics and stamps of the images: left and right at the beginning, left and right at the end; an empty topic: there is none.
string[] topics
builtin_interfaces/Time[] stamps
# Downwards, in base_link (FLU) at the beginning.
geometry_msgs/Vector3 down
# Height above the ground and its standard deviation, m; 0: not known.
float64 height
float64 height_sigma
""",
    RESET: """\
# The estimate jumped: new = old (+) delta.
# header.stamp: when; header.frame_id: map (ENU at the map origin), the axes of all three deltas.
std_msgs/Header header
# Jumps so far, this one included.
uint32 counter
# m
geometry_msgs/Vector3 delta_position
# m/s
geometry_msgs/Vector3 delta_velocity
# rad, about the axes of map
geometry_msgs/Vector3 delta_rotation
""",
    INTEGRITY: """\
# How far off the position may be at a stated risk, and whether it may be used.
# header.stamp: that of the estimate; header.frame_id: map.
std_msgs/Header header
# usable, caution, do not use; not judged: no alert limit is configured. A state without a successor for longer than
# [integrity] time_to_alert_s counts as do not use.
string state
string reason
# Horizontal and vertical protection level, m, which the error exceeds so many times an hour; infinite: nothing bounds it.
float64 risk_per_hour
float64 hpl
float64 vpl
# Horizontal and vertical alert limit, m; infinite: none.
float64 hal
float64 val
# Protection levels at other risks.
float64[] risks_per_hour
float64[] hpls
float64[] vpls
# Standard deviations, m (horizontal: per axis), of the Gaussian that has the first of these protection levels.
float64 sigma_h
float64 sigma_v
""",
    CHECKPOINT: """\
# Where the estimator was interrupted: the first message of a log whose estimate goes on from an earlier one.
# header.stamp: validity; header.frame_id: map. Numbers in the estimator's own axes, NED and FRD.
std_msgs/Header header
# Position n, velocity n, quaternion wxyz body -> n, gyro bias, accelerometer bias; SI.
float64[16] nav
# Of position, velocity, attitude (about the axes of the body), gyro bias, accelerometer bias; row by row.
float64[225] covariance
# When an absolute position was last fused, ns since 1970; negative: never.
int64 last_absolute_ns
uint32 reset_counter
# Latitude and longitude in degrees, ellipsoid height in m; empty: a map that is nowhere on Earth.
float64[] origin
# Last trusted GNSS: latitude, longitude, height, age in s, sigma in m; empty: none.
float64[] last_gnss
""",
}

STORE: Final = get_typestore(Stores.ROS2_HUMBLE)
_OTHERS: Final = {
    EXTENDED_STATE: "std_msgs/Header header\nuint8 vtol_state\nuint8 landed_state\n",
    ISAAC_STATUS: """\
std_msgs/Header header
uint8 vo_state
float64 node_callback_execution_time
float64 track_execution_time
float64 track_execution_time_mean
float64 track_execution_time_max
""",
    ZED_STATUS: "uint8 odometry_status\n",  # up to three more bytes follow, by version
}
for _name, _text in (LANDFIX_MSGS | _OTHERS).items():
    STORE.register(get_types_from_msg(_text, _name))


_LATER: Final = {LANDMARK_FIX: (b"directions", 8)}  # a field that a type's first version did not have; bytes of all since, empty


def missing_end(name: str, text: bytes) -> bytes:
    """What a message of older definition `text` lacks at its end."""
    field, size = _LATER.get(name, (b"", 0))
    return bytes(size) if size and field not in text else b""


def is_known(name: str) -> bool:
    """Whether a type is one of ROS 2 Humble's or ours."""
    return name in STORE.fielddefs


@cache
def schema_text(name: str) -> str:
    """ros2msg text with dependencies; ours with comments. KeyError: unknown."""
    if not is_known(name):
        raise KeyError(name)
    text, _ = STORE.generate_msgdef(name, ros_version=2)
    if name in LANDFIX_MSGS:
        text = LANDFIX_MSGS[name] + text[text.index("=" * 80) :]
    return text


@cache
def type_hash(name: str) -> str:
    """RIHS01 hash, as RIHS01_3cc97dc7... of nav_msgs/msg/Odometry. KeyError: unknown."""
    if not is_known(name):
        raise KeyError(name)
    return STORE.hash_rihs01(name)


SCHEMAS: Final = {
    name: schema_text(name)
    for name in (
        HEADER, IMU, NAV_SAT_FIX, TWIST, POSE_FIX, PRESSURE, MAGNETIC_FIELD, RANGE, ODOMETRY, POSE, TF, DIAGNOSTICS, IMAGE,
        COMPRESSED_IMAGE, CAMERA_INFO, *LANDFIX_MSGS,
    )
}  # fmt: skip
