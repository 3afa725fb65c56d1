"""Print landfix' estimates: python subscribe.py [COUNT] [tcp/127.0.0.1:7447] (ENU from the map's origin)."""

import queue
import sys

import numpy as np
import zenoh
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_JAZZY)
count = int(sys.argv[1]) if len(sys.argv) > 1 else 10**9
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", f'["{sys.argv[2] if len(sys.argv) > 2 else "tcp/127.0.0.1:7447"}"]')
heard: queue.SimpleQueue[bytes] = queue.SimpleQueue()
with zenoh.open(config) as session:
    key = "0/landfix/odometry/nav_msgs::msg::dds_::Odometry_/*"
    subscriber = session.declare_subscriber(key, lambda sample: heard.put(sample.payload.to_bytes()))
    for _ in range(count):
        message = store.deserialize_cdr(heard.get(), "nav_msgs/msg/Odometry")
        at, sigma = message.pose.pose.position, np.sqrt(np.diag(message.pose.covariance.reshape(6, 6))[:3])
        t = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        print(f"{t:.3f} s  east {at.x:.2f} north {at.y:.2f} up {at.z:.2f} m, one sigma {sigma.round(2)} m", flush=True)
