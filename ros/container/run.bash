#!/usr/bin/env bash
# Run Nav2's own test of the docking server (test), or a complete bringup with a docking (bringup), in the container.
set -eo pipefail
source /opt/ros/jazzy/setup.bash
source /venv/bin/activate
source /ws/install/setup.bash
here=$(dirname "$(readlink -f "$0")")
cd "$(mktemp -d)"

case "$1" in
test)
    tests=/navigation2/nav2_docking/opennav_docking/test
    python3 "$here/nav2_docking_test.py" "$tests/test_docking_server.py" >test_optdock_docking_server.py
    python3 -u -m pytest -s test_optdock_docking_server.py
    ;;
bringup)
    ros2 launch "$here/bringup.launch.py" &
    trap 'kill -INT $!; wait' EXIT
    until [[ "$(ros2 lifecycle get /docking_server 2>/dev/null)" == active* ]]; do sleep 1; done
    pose="{position: {x: -2.0, y: -0.5}, orientation: {w: 1.0}}"
    ros2 topic pub --times 3 /initialpose geometry_msgs/msg/PoseWithCovarianceStamped \
        "{header: {frame_id: map}, pose: {pose: $pose}}"
    timeout 120 python3 "$here/../optdock_ros/examples/dock_and_undock.py"
    ;;
*)
    echo "usage: test | bringup" >&2
    exit 2
    ;;
esac
