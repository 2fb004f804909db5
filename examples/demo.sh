#!/usr/bin/env bash
# The whole suite, live: a simulated bench, the trajectory publisher, the recorder, the identification node and the
# experiment node as separate processes, driven by "characterize". Everything is left in out/demo. With --free-shaft, there is no
# load machine: a first start finds the angle, then the drive swings its own shaft. --seconds 5.0 makes it short.
set -euom pipefail # m: processes in groups of their own, so that Ctrl-C reaches this script, which ends them in order
output=$(realpath -m "${1:-out/demo}")
free_shaft='' seconds=10.0
while [ $# -gt 1 ]; do
    shift
    case $1 in
    --free-shaft) free_shaft=$1 ;;
    --seconds) seconds=${2:?"--seconds needs a number, as in 5.0: the length of the experiment"} && shift ;;
    *) echo "demo: there is no option $1: --free-shaft, or --seconds with the length of the experiment." >&2 && exit 2 ;;
    esac
done
export PYTHONUNBUFFERED=1 ROS_LOG_DIR="$output/log/ros"

rm -rf "$output"
mkdir -p "$output/log"
declare -A node  # name to process

start() { # NAME, its parameters as NAME:=VALUE
    local name=$1 parameters=() room=nodes
    [ "$name" != experiment ] || room=ros
    shift
    for parameter in "$@"; do parameters+=(-p "$parameter"); done
    python -m "drive_id.$room.$name" --ros-args "${parameters[@]}" >"$output/log/$name.log" 2>&1 &
    node[$name]=$!
}

stop_all() {
    kill -INT "${node[@]}" 2>/dev/null || true
    local name status=0
    for name in "${!node[@]}"; do
        wait "${node[$name]}" || { status=$?; echo "demo: $name ended with exit code $status:" >&2; tail -n 20 "$output/log/$name.log" >&2; }
    done
    node=()
    return "$status"
}
end() { # of this script, also by Ctrl-C
    if [ -n "$client" ] && kill -INT "$client" 2>/dev/null; then
        wait "$client" || true # it brings the bench to rest
    fi
    [ ${#node[@]} -eq 0 ] || stop_all || true
}
client=
trap end EXIT
trap 'exit 130' INT TERM

patient=(lead_time:=1.5 watch_timeout:=30.0 clock_offset:=30.0) # for busy computers; keep the defaults on a bench
if [ "$free_shaft" = --free-shaft ]; then
    echo "A simulated drive without load machine is identified: a first start finds the angle of its rotor, 2 rad off, then it"
    echo "swings its own shaft up to 1340 rpm. This takes about two minutes. Logs: $output/log."
    start bench_simulator machine:=spm free_shaft:=true current_noise:=0.001 resolver_offset:=-2.0 speed_observer:=100.0 \
        "truth_file:='$output/truth.npz'"
    start recorder "data_directory:='$output'"
    # Nobody asks for a map of the live samples: no fits in the background, which the swing would share the cores with.
    start identification "data_directory:='$output'" "output_directory:='$output'" i_max:=20.0 pole_pairs:=3 picture:=true \
        refit_share:=0.0
    start trajectory_publisher i_max:=20.0 shaft_speed_max:=420.0 "duration:=$seconds" "${patient[@]}"
    options=(--first-start --free-shaft --drive bench_simulator)
    result=recording
else
    echo "A simulated drive is identified: an interior-magnet machine of 300 A with rotor harmonics and an uncompensated"
    echo "inverter, at 500 rpm. This takes about a minute, at the first start 90 s. Logs: $output/log."
    start bench_simulator machine:=ipm "speeds:=[500.0]" current_noise:=0.001 "truth_file:='$output/truth.npz'"
    start recorder "data_directory:='$output'"
    start identification "data_directory:='$output'" "output_directory:='$output'" i_max:=300.0 pole_pairs:=4 picture:=true
    start trajectory_publisher i_max:=300.0 "duration:=$seconds" "${patient[@]}"
    options=(--compare)
    result=recording_full
fi

start experiment
python -m drive_id.ros.characterize "${options[@]}" --recording bag --truth "$output/truth.npz" --output "$output" &
client=$!
status=0
wait -n || status=$? # whoever ends first; it must be the client
if kill -0 "$client" 2>/dev/null; then
    echo "demo: a node has died during the experiment." >&2
    kill -INT "$client" 2>/dev/null || true
    wait "$client" || true
    status=1
fi
client=
[ "$status" -eq 0 ] || for log in "$output"/log/*.log; do
    echo "--- $log" >&2
    tail -n 20 "$log" >&2
done
stop_all || status=1
[ "$status" -eq 0 ] || exit "$status"

echo
echo "4. The same recording, read without ROS by the command line:"
drive-id info "$output/bag"
echo
if [ "$free_shaft" = --free-shaft ]; then
    echo "Map, mechanics and pictures are in $output/$result: open report.html in a browser."
    exit
fi
drive-id report "$output/$result" --output "$output/$result/report.html"
echo
echo "Without a model of the inverter (psm) its voltage error ends up in the flux map. Maps and pictures are in"
echo "$output/recording_psm, recording_full, live_full and live_joint: look at flux_map.png,"
echo "and open recording_full/report.html in a browser."
