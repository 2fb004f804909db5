"""The gate for all input files: regular files of bounded size, archives and YAML of bounded content."""
