"""What engineers do with identified maps: pictures and derived quantities."""
