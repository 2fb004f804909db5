#!/usr/bin/env bash
# Build wheel and sdist, install each into an environment of its own without ROS, and use it from another folder.
set -euo pipefail
output=$(realpath -m "${1:?folder for wheel and sdist}")
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

rm -rf "$output"
python -m build --outdir "$output" . >"$scratch/build.log" 2>&1 || { tail -n 30 "$scratch/build.log" >&2; exit 1; }
for distribution in "$output"/*.whl "$output"/*.tar.gz; do
    echo "Installing $(basename "$distribution")"
    python -m venv --clear "$scratch/venv"
    # Not the variables of the ROS wheels' hook: the new environment has none of them.
    env -u LD_LIBRARY_PATH -u _ROS_WHEELS_BOOTSTRAP_COMPLETE -u PYTHONPATH bash -euo pipefail -c '
        "$0/venv/bin/pip" install --quiet --disable-pip-version-check "$1"
        cd "$0"
        rm -rf bag result
        venv/bin/drive-id simulate --machine ipm --seconds 2 --noise 0.001 --output bag --quiet
        venv/bin/drive-id fit bag --output result --quiet
        venv/bin/drive-id info result >info.txt # head closes a pipe early, which drive-id would report
        head -n 12 info.txt
    ' "$scratch" "$distribution"
done
