#!/usr/bin/env bash
# Build the plugin if need be, run the world headless, leave log.csv: ./run.sh [SECONDS], the most that it may take of wall-clock time.
# It needs Gazebo Classic 11 with its headers (Debian bullseye: gazebo libgazebo-dev g++ cmake make), no ROS and no screen.
set -euo pipefail
cd "$(dirname "$0")"
longest=${1:-600}

if [ ! -e build/libcrane_drives.so ]; then
  cmake -Wno-dev -S . -B build >/dev/null
  cmake --build build >/dev/null
fi
rm -f log.csv log.csv.part

set +u
. /usr/share/gazebo/setup.sh
set -u
export GAZEBO_MODEL_DATABASE_URI=  # else it asks the network for models
export GAZEBO_IP=127.0.0.1
export GAZEBO_MASTER_URI=http://127.0.0.1:${PORT:-$((20000 + RANDOM % 20000))}  # a port of its own for each run
export GAZEBO_MODEL_PATH=$PWD/models GAZEBO_PLUGIN_PATH=$PWD/build
export HOME=$PWD/build ALSOFT_DRIVERS=null  # its logs; no sound

timeout -k 10 "$longest" gzserver world.sdf >build/gzserver.log 2>&1 || code=$?
if [ ! -e log.csv ]; then
  echo "no log.csv after ${longest} s at most, exit code ${code:-0}; see build/gzserver.log" >&2
  exit 1
fi
