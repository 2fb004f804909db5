"""The rclpy nodes: they declare parameters, make endpoints, call and publish; the only room that imports rclpy."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is loaded; our matrices are small: more threads wait
