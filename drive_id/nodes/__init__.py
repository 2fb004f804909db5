"""The rclpy nodes: they declare parameters, make endpoints, call and publish; the only room that imports rclpy."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # our matrices are small: more threads only wait, and take the cores
