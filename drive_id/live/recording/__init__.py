"""What the recorder does, without ROS: recording sessions, their report and health."""
