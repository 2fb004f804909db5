"""What the nodes do, without ROS: live identification, recording sessions, their health."""
