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
(cd "$work" && "$root/$python" "$root/examples/figure_for_a_paper.py")
mv "$work/pulses.svg" docs/pictures/pulses.svg
"$python" docs/draw.py
"$python" -m cranedyn export page "$work/crane.html"
"$python" - "$work/crane.html" docs/pictures/drive.gif <<'PYTHON'
import io
import shutil
import sys
from pathlib import Path

from PIL import Image
from selenium import webdriver

options = webdriver.ChromeOptions()
options.binary_location = shutil.which("chromium")
flags = "headless no-sandbox use-gl=angle use-angle=swiftshader enable-unsafe-swiftshader window-size=1260,840"
for flag in flags.split():
    options.add_argument(f"--{flag}")
driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
driver.get(Path(sys.argv[1]).resolve().as_uri())
# A screenshot takes long, so that the crane moves at a third of its speed meanwhile.
driver.execute_script("page.act('free'); page.worker.postMessage({type: 'speed', factor: 0.33})")
event = "document.body.dispatchEvent(new KeyboardEvent(arguments[0], {code: arguments[1], bubbles: true}))"
presses = [(1.0, "keydown", "KeyW"), (5.0, "keyup", "KeyW"), (13.0, "keydown", "ArrowLeft"), (17.0, "keyup", "ArrowLeft")]
times, frames = [], []
while not times or times[-1] < 25.0:
    time = driver.execute_script("return page.state ? page.state.t : 0")
    while presses and time >= presses[0][0]:
        driver.execute_script(event, *presses.pop(0)[1:])
    if times and time < times[-1] + 0.6:
        continue
    times.append(time)
    picture = Image.open(io.BytesIO(driver.get_screenshot_as_png())).convert("RGB").resize((600, 400))
    frames.append(picture.quantize(40, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE))
driver.quit()
durations = [round(1000 * (after - before)) for before, after in zip(times, times[1:])]
frames[0].save(sys.argv[2], save_all=True, append_images=frames[1:-1], duration=durations, loop=0, optimize=True)
PYTHON
"$python" -m experiments.lift --site cranedyn/lifts/planning/sites/tower.toml --lifts 50 --out "$work/lift"
"$python" -m experiments.snapshot "$work/lift/lift.rrd" -t 28 --view 3d -o "$work"
mv "$work/lift-28s.png" docs/pictures/lift.png
mv "$work/lift/site_tower.png" docs/pictures/lift_site.png
"$python" - "$work" <<'PYTHON'
import re
import sys
from pathlib import Path

for page in ("tutorial/first_lift.md",):
    path = Path("docs", page)
    (table,) = re.findall(r"^```toml\n(.*?)^```", path.read_text(encoding="utf-8"), re.S | re.M)
    Path(sys.argv[1], f"{path.stem}.toml").write_text(table, encoding="utf-8")
PYTHON
"$python" -m experiments.lift_report --site "$work/first_lift.toml" --lifts 50 --gusts 1 --out "$work/first_lift" || test $? = 1  # no go
"$python" -m experiments.lift --site "$work/first_lift.toml" --lifts 0 --out "$work/first_lift_site" || test $? = 1  # risk not judged
"$python" -m experiments.lift_report --site signed_lift --lifts 1000 --out "$work/signed_lift"
"$python" - "$work" <<'PYTHON'
import io
import shutil
import sys
from pathlib import Path

from PIL import Image
from selenium import webdriver

work = Path(sys.argv[1])
yard = Image.open(work / "first_lift_site" / "site_first_lift.png").convert("RGB")
yard = yard.resize((yard.width * 4 // 5, yard.height * 4 // 5), Image.Resampling.LANCZOS)
yard.quantize(64).save("docs/pictures/first_lift.png", optimize=True)
options = webdriver.ChromeOptions()
options.binary_location = shutil.which("chromium")
for flag in ("headless", "no-sandbox", "hide-scrollbars", "window-size=1100,1250"):
    options.add_argument(f"--{flag}")
driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
driver.get((work / "signed_lift" / "lift.html").resolve().as_uri())
report = Image.open(io.BytesIO(driver.get_screenshot_as_png())).convert("RGB")
driver.quit()
report.quantize(128, method=Image.Quantize.MAXCOVERAGE).save("docs/pictures/lift_report.png", optimize=True)
PYTHON
"$python" - "$work/site.rrd" <<'PYTHON'
import sys

from cranedyn.lifts.sites.plan import plan_site
from cranedyn.lifts.sites.site_simulation import simulate_site
from cranedyn.lifts.sites.crane_site_file import read_crane_site

plan = plan_site(read_crane_site("two_towers"), [("north", [-9, -7, 16]), ("south", [-36, -38, 30])])
simulate_site(plan.site, plan.operators(), duration=plan.duration + 5).record(sys.argv[1])
PYTHON
"$python" -m experiments.snapshot "$work/site.rrd" -t 36 --size 1200 640 -o "$work"
mv "$work/site-36s.png" docs/pictures/several_cranes.png
# The building models of docs/howto/real_sites.md are not in the repository.
if test -f examples/real_sites/AC20-FZK-Haus.ifc; then
  "$python" -m experiments.lift_report --site examples/real_sites/house.toml --lifts 0 --gusts 0 --out "$work/house" || test $? = 1  # risk not judged
  pdftoppm -r 70 -f 2 -l 2 -singlefile -png "$work/house/lift.pdf" docs/pictures/real_house
  "$python" -m experiments.site --site examples/real_sites/office_and_house.toml --out "$work/real_site"
  mv "$work/real_site/timetable.png" docs/pictures/real_site_timetable.png
fi
"$python" -m experiments.lift_report --positions=-6:6:4,-4:4:3 --out "$work/places"
mv "$work/places/places.png" docs/pictures/compare_lifts.png
"$python" -m experiments.site --site two_towers --hours 0.02 --minutes 6 --out "$work/site" || test $? = 1  # too short for its claims
mv "$work/site/invariant.png" docs/pictures/site_invariant.png
"$python" -m experiments.tandem --out "$work/tandem"
mv "$work/tandem/shares.png" docs/pictures/tandem_shares.png
for experiment in rope cylinders; do
  "$python" -m "experiments.$experiment" --engine compiled --out "$work/$experiment"
  mv "$work/$experiment/$experiment.png" docs/pictures/
done
"$python" -m experiments.snapshot "$work/tandem/tandem.rrd" -t 9 --size 1050 600 -o "$work"
mv "$work/tandem-9s.png" docs/pictures/tandem.png
"$python" -m experiments.sweep --out "$work/sweep"
mv "$work/sweep/sweep_map.png" "$work/sweep/sweep_timing.png" docs/pictures/
"$python" -m experiments.sweep --drive velocity --durations 3 --out "$work/sweep_velocity"
mv "$work/sweep_velocity/sweep_map.png" docs/pictures/sweep_map_velocity.png
for drive in ideal velocity; do
  "$python" -m experiments.sweep --cases 5000 --drive $drive --without "flat + compiled MPC" "MPC to the goal" --out "$work/drawn_$drive"
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
