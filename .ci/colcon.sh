#!/usr/bin/env bash
# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
# The tree in a colcon workspace, as on a machine with ROS 2: it builds, its executables are where `ros2 run` looks, and the loop runs.
set -euo pipefail
cd "$(dirname "$0")/.."
venv=$PWD/.venv
workspace=$(mktemp -d)
trap 'rm -rf "$workspace"' EXIT
mkdir "$workspace/src"
PYTHONPATH=.ci "$venv/bin/python" -c 'import sys, pathlib, sources; sources.copy_sources(pathlib.Path(sys.argv[1]))' "$workspace/src/hyst_control"
cd "$workspace"
export PATH=$venv/bin:$PATH AMENT_PREFIX_PATH=$venv
colcon build --packages-select hyst_control --event-handlers console_cohesion+ > build.txt 2>&1 || { cat build.txt; exit 1; }
set +u
source install/setup.bash
set -u
share=$(python -c 'from ament_index_python import get_package_share_directory as share; print(share("hyst_control"))')
[ "$share" = "$workspace/install/hyst_control/share/hyst_control" ] || { echo "the ament index leads to $share"; exit 1; }
for executable in $(python -c 'import runpy
nodes = runpy.run_path("src/hyst_control/hyst_control/processes/node_list.py")["NODES"]
print(*(name for name, node in nodes.items() if node.installed))'); do
    [ -x "$share/../../lib/hyst_control/$executable" ] || { echo "no executable $executable in lib/hyst_control"; exit 1; }
done
[ -f "$share/config/nodes/lockstep.yaml" ] || { echo "no config in share"; exit 1; }
"$share/../../lib/hyst_control/pipeline" --ros-args --params-file "$share/config/nodes/lockstep.yaml"
[ -f bag/metadata.yaml ] || { echo "the pipeline left no bag"; exit 1; }
colcon test --packages-select hyst_control --event-handlers console_cohesion+ --pytest-args " -k" test_pi > test.txt 2>&1 || { tail -50 test.txt; exit 1; }
colcon test-result | grep -E "Summary: [1-9][0-9]* tests, 0 errors, 0 failures" || { cat test.txt; echo "colcon test ran no tests"; exit 1; }
echo "colcon build: installs, the loop runs from it, and colcon test runs the tests"
