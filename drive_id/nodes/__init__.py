"""The ROS 2 nodes: parameters, topics, services and diagnostics; the only package that imports rclpy."""

import os

# Before numpy is loaded: small matrices gain nothing from more threads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
