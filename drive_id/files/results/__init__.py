"""Results, information files, checkpoints and plans on disk."""
