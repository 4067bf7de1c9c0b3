#!/usr/bin/env bash
# The pictures of the README, from a recording of the demo; run from the top of the repository.
set -euo pipefail
python=${PYTHON:-.venv/bin/python}
work=$(mktemp -d)
"$python" -m experiments.demo --cycles 1 --out "$work/demo"
"$python" -m experiments.snapshot "$work/demo/demo.rrd" -t 115 --size 1200 640 -o "$work"
mv "$work/demo-115s.png" docs/crane.png
"$python" -m experiments.snapshot "$work/demo/demo.rrd" --gif 86 118 docs/demo.gif --fps 5 --view 3d --size 480 400
"$python" -m experiments.demo --cycles 1 --control flat --out "$work/flat"
"$python" -m experiments.snapshot "$work/flat/demo.rrd" -t 110 --size 1200 640 -o "$work"
mv "$work/demo-110s.png" docs/controlled.png
rm -r "$work"
