#!/usr/bin/env bash
# The pictures of the README, from a recording of the demo; run from the top of the repository.
set -euo pipefail
python=${PYTHON:-.venv/bin/python}
work=$(mktemp -d)
"$python" -m experiments.demo --cycles 1 --engine compiled --out "$work/demo"
"$python" -m experiments.snapshot "$work/demo/demo.rrd" -t 115 --size 1200 640 -o "$work"
mv "$work/demo-115s.png" docs/crane.png
"$python" -m experiments.snapshot "$work/demo/demo.rrd" --gif 86 118 docs/demo.gif --fps 5 --view 3d --size 480 400
"$python" -m experiments.demo --cycles 1 --control flat --engine compiled --out "$work/flat"
"$python" -m experiments.snapshot "$work/flat/demo.rrd" -t 110 --size 1200 640 -o "$work"
mv "$work/demo-110s.png" docs/controlled.png
root=$PWD
(cd "$work" && "$root/$python" "$root/examples/first_run.py")
mv "$work/first_run.png" docs/first_run.png
rm -r "$work"
