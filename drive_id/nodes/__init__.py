"""The ROS 2 nodes: parameters, topics, services and diagnostics; the only package that imports rclpy."""

import os

os.environ.setdefault(
    "OPENBLAS_NUM_THREADS", "1"
)  # before numpy is loaded; small matrices gain nothing from more threads
