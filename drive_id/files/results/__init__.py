"""Results, information files and plans on disk."""
