"""Send one pose fix to landfix: python publish.py EAST NORTH UP YAW_DEG [tcp/127.0.0.1:7447] (ENU from [map] origin)."""

import math
import sys
import time

import numpy as np
import zenoh
from rosbags.typesys import Stores, get_typestore

TYPE = "geometry_msgs/msg/PoseWithCovarianceStamped"
store = get_typestore(Stores.ROS2_JAZZY)
make = {name.rsplit("/")[-1]: cls for name, cls in store.types.items()}

east, north, up, yaw = map(float, sys.argv[1:5])
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", f'["{sys.argv[5] if len(sys.argv) > 5 else "tcp/127.0.0.1:7447"}"]')
with zenoh.open(config) as session:
    seconds, nanoseconds = divmod(time.time_ns(), 10**9)  # of validity: when the sensor saw it
    stamp = make["Header"](stamp=make["Time"](sec=seconds, nanosec=nanoseconds), frame_id="map")
    turn = make["Quaternion"](x=0.0, y=0.0, z=math.sin(math.radians(yaw) / 2), w=math.cos(math.radians(yaw) / 2))
    pose = make["Pose"](position=make["Point"](x=east, y=north, z=up), orientation=turn)
    covariance = np.diag([0.3**2] * 3 + [math.radians(2.0) ** 2] * 3).ravel()  # m^2, rad^2 (x y z, about east north up)
    fix = make["PoseWithCovarianceStamped"](header=stamp, pose=make["PoseWithCovariance"](pose=pose, covariance=covariance))
    key = f"0/pose_fix/geometry_msgs::msg::dds_::PoseWithCovarianceStamped_/{store.hash_rihs01(TYPE)}"
    session.put(key, bytes(store.serialize_cdr(fix, TYPE)))
