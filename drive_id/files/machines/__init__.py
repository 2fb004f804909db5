"""Machine files and ground truth."""
