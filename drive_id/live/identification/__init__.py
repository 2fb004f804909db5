"""What the identification node does, without ROS: live samples, background fits, requests, results."""
