"""Everything that touches the disk: bags, machine files, signals files and results. Never imports rclpy."""
