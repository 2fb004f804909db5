#!/bin/sh
# Print the Python that the environment is made with: the one that is named, or else python3 if it fits, or else the
# newest on the PATH that does. One that fits has ROS 2 wheels; where a ROS 2 is sourced, it is that one's, python3.
#
# Usage: sh tools/fitting_python.sh [PYTHON]
OLDEST=10 # minor versions of Python 3: that of drive_id itself, and the newest one with wheels
NEWEST=13 # as WHEELS_FOR in setup_environment.py

minor() { # PYTHON: print its minor version; nothing if there is none, or it is no Python 3
    "$1" -c 'import sys; sys.version_info[0] == 3 and print(sys.version_info[1])' 2>/dev/null
}

fail() { # SENTENCE
    echo "drive_id: $1" >&2
    exit 1
}

if [ -n "${1:-}" ] || [ -n "${ROS_DISTRO:-}" ]; then
    named=${1:-python3}
    found=$(minor "$named")
    [ "${found:-0}" -ge $OLDEST ] || fail "$named is not a Python 3.$OLDEST or newer: install one, or name it (make \
PYTHON=/path/to/python3 ...)."
    echo "$named"
    exit
fi
for name in python3 python3.13 python3.12 python3.11 python3.10; do
    found=$(minor $name)
    if [ "${found:-0}" -ge $OLDEST ] && [ "$found" -le $NEWEST ]; then
        echo $name
        exit
    fi
done
found=$(minor python3)
fail "There are ROS 2 wheels for Python 3.$OLDEST to 3.$NEWEST, none of which is on the PATH${found:+ (python3 is \
3.$found)}: install one with venv and headers (by uv python install 3.$NEWEST, pyenv, or apt where it is packaged), or \
name it (make PYTHON=/path/to/python3.$NEWEST ...), or source a ROS 2 of your own."
