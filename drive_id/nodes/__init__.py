"""The rclpy nodes: they declare parameters, make endpoints, call and publish; the only room that imports rclpy."""
