"""Plan motions: lifts past obstacles that are proven to touch nothing, and moves of least time.

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

How a lift is planned, in the order to read: `clearance` measures distances between crane and
obstacles (`crane_bodies`, `solids`, `fields`), `motion_proof` proves them for whole curves,
`path_search` finds a way, `curve` rounds its corners, `timing` moves the load along it, `lift` puts
these together, and `certificate` simulates the lift and checks it. An optimal control problem is
stated by `move` and `half_spaces` and solved by `transcription`.

An obstacle of a new kind is a function in a module of its own, entered in `site_file.SOLIDS`.
Planning needs the extra `planning`; docs/concepts/planning.md says how it works.
"""
