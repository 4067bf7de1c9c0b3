#!/usr/bin/env bash
# The pictures of the documents, from runs that take some minutes; run from the top of the repository.
set -euo pipefail
python=${PYTHON:-.venv/bin/python}
work=$(mktemp -d)
"$python" -m experiments.demo --cycles 1 --engine compiled --out "$work/demo"
"$python" -m experiments.snapshot "$work/demo/demo.rrd" -t 115 --size 1200 640 -o "$work"
mv "$work/demo-115s.png" docs/pictures/crane.png
"$python" -m experiments.demo --cycles 1 --control shaped --engine compiled --out "$work/shaped"
for control in demo shaped; do
  "$python" - "$work/$control/demo.parquet" "$work/$control.rrd" <<'PYTHON'
import sys
from cranedyn.data.trajectory import read
from cranedyn.model.load import load_crane
from cranedyn.recording import Run, record
run = read(sys.argv[1])
record(sys.argv[2], [Run("demo", load_crane(from_record=run.record), run)], title="Demo")
PYTHON
  "$python" -m experiments.snapshot "$work/$control.rrd" --gif 76 112 "$work/$control.gif" --fps 6 --view 3d --size 400 360
done
mv "$work/demo.gif" docs/pictures/swing.gif
mv "$work/shaped.gif" docs/pictures/no_swing.gif
"$python" -m experiments.demo --cycles 1 --control flat --engine compiled --out "$work/flat"
"$python" -m experiments.snapshot "$work/flat/demo.rrd" -t 110 --size 1200 640 -o "$work"
mv "$work/demo-110s.png" docs/pictures/controlled.png
root=$PWD
(cd "$work" && "$root/$python" "$root/examples/first_run.py")
mv "$work/first_run.png" docs/pictures/first_run.png
"$python" -m experiments.lift --site cranedyn/planning/sites/tower.toml --lifts 50 --out "$work/lift"
"$python" -m experiments.snapshot "$work/lift/lift.rrd" -t 28 --view 3d -o "$work"
mv "$work/lift-28s.png" docs/pictures/lift.png
mv "$work/lift/site_tower.png" docs/pictures/lift_site.png
"$python" -m experiments.sweep --out "$work/sweep"
mv "$work/sweep/sweep_map.png" "$work/sweep/sweep_timing.png" docs/pictures/
"$python" -m experiments.sweep --drive velocity --durations 3 --out "$work/sweep_velocity"
mv "$work/sweep_velocity/sweep_map.png" docs/pictures/sweep_map_velocity.png
for drive in ideal velocity; do
  "$python" -m experiments.sweep --cases 1000 --drive $drive --out "$work/drawn_$drive"
done
mv "$work/drawn_ideal/sweep_map.png" docs/pictures/sweep_drawn_map.png
mv "$work/drawn_velocity/sweep_map.png" docs/pictures/sweep_drawn_velocity_map.png
"$python" -m experiments.a1 --gravity 9.8 --engine compiled --out "$work/a1"
mv "$work/a1/budget.png" docs/pictures/a1_budget.png
"$python" -m experiments.validate --engine compiled --out "$work/validate"
mv "$work/validate/convergence.png" docs/pictures/
"$python" -m experiments.compare --engine compiled --out "$work/compare" --only \
  "operator" "operator + ZVD" "spline + PD" "paper's LQR + PID" "flat + LQR" "MPC to the goal"
mv "$work/compare/robustness.png" docs/pictures/compare_robustness.png
"$python" -m experiments.compare --drive velocity --engine compiled --out "$work/compare_velocity" --only \
  "operator" "operator + ZVD" "spline + PD" "full-model LQR" "flat + LQR" "MPC to the goal"
mv "$work/compare_velocity/robustness.png" docs/pictures/compare_velocity_robustness.png
"$python" -m experiments.margins --engine compiled --out "$work/margins"
mv "$work/margins/margins_map.png" docs/pictures/
"$python" -m experiments.factors --out "$work/factors"
mv "$work/factors/needed.png" docs/pictures/factors_needed.png
"$python" -m experiments.identify --out "$work/identify"
mv "$work/identify/twin_1.png" docs/pictures/twin.png
rm -r "$work"
