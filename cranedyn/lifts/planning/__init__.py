"""Plan motions: lifts past obstacles that are proven to touch nothing, moves of least time, and
references to compare these with.

Begin with `lift.plan_lift`: it takes a site and the limits of the drives, and returns a motion that
keeps the required distance from every obstacle, with the load at rest at the end.

    from cranedyn.lifts.planning.certificate import certify
    from cranedyn.lifts.planning.lift import plan_lift
    from cranedyn.lifts.planning.site_file import SITES, read_site

    site = read_site(SITES / "city_block.toml")
    certificate = certify(plan_lift(site, site.limits))
    print(certificate.holds, certificate.nearest)

Public names:

* `site_file.read_site` reads a `site.Site` from TOML: obstacles, crane, load, start and goal.
* `lift.plan_lift` returns a `lift.Lift`, or raises `lift.NoWay` with the reason.
* `certificate.certify` simulates it under its controller and checks it again, between all instants.
* `perturbed.perturb` simulates it thousands of times with other loads, cables, winds and sensors.
* `optimal.optimal` solves moves of least time or swing by optimal control, also past obstacles;
  `least_time.in_least_time` shortens a planned lift with it. Both need the extra `optimal`.

In the order to read:

1. `site` says what a lift is given; `solids` are its obstacles. `site_file` reads both, with
   `site_table`, `bim` and `ifc_shapes`; `plausibility` finds values that cannot be meant.
2. `clearance` measures distances between crane and obstacles (`crane_bodies`, `fields`), and
   `motion_proof` proves them for whole motions.
3. `path_search` finds a way, `curve` rounds its corners, `timing` moves the load along it, and
   `lift` puts these together.
4. `certificate` simulates the lift and checks it: also by `standing` (what the crane stands on),
   `coverage` (no pair of a body and an obstacle is left out) and `remeasure` (distances by another
   method). `plan_assumptions` lists what it rests on. `perturbed` varies it.
5. `ground_lift` lifts a load off what it stands on and sets it down, on a `support`.
6. An optimal control problem is stated by `move` and `half_spaces`, solved by `transcription`,
   checked as a `drive_trajectory`, and asked for by `optimal` and `least_time`.

Beside these are references to compare with: `itinerary`, a tour that is repeated, and `joystick`, a
person at the joystick.

An obstacle of a new kind is a function in a module of its own, entered in `site_file.SOLIDS`.
Planning needs the extra `planning`; docs/concepts/planning.md says how it works.
"""
