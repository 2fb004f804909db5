"""What every room uses: sentences and numbers for people, settings, origins, health, the version."""
