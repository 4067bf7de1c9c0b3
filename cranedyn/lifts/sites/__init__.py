"""Several cranes on one site, each kept by its own brakes in a box that no other's comes near.

    from cranedyn.lifts.sites.site_simulation import simulate_site
    from cranedyn.lifts.sites.crane_site_file import read_crane_site

    site = read_crane_site("two_towers")
    rates = [0.05, 0.0, 0.0], [-0.05, 0.0, 0.0]  # slew, trolley, hoist [rad/s and m/s]
    operators = [lambda t, states, rate=rate: rate for rate in rates]
    run = simulate_site(site, operators, duration=60.0)
    print(run.contacts, run.least_distance)

Public names:

* `crane_site_file.read_crane_site` reads a `crane_site.CraneSite` from TOML: cranes, each a
  `crane_site.Station`.
* `placed_capsules.crane_bodies` covers a crane with capsules; `distance_proof.proven_apart` proves
  a distance for all positions in two boxes.
* `brakes.Brakes` says where a crane may pass before it stands; `working_wind.WorkingWind` up to
  which wind the cranes of a site work.
* `promise.site_assumptions` lists all that the promise of a site rests on.
* `supervisor.Supervisor` and `guard.Guard` reserve boxes and keep to them.
* `plan.plan_site` plans lifts in space and time; `plan.SitePlan` is proven slice by slice.
* `shift_plan.plan_shift` plans the `lift_list.ListedLift` of a site as one shift,
  `timetable.timetable` shows when each is done by which crane, and `conflicts.nearest_bodies` which
  parts of two cranes are in each other's way.
* `operators.LiftOperator` lifts loads as people do; `adversaries.attacks_on` looks for contacts
  that the supervisor does not prevent; `zones.static_zones` are boxes that need no supervisor.
* `site_simulation.simulate_site` steps all cranes by one clock, with late and lost messages; its
  run is written as a table, as a recording and, by `site_page.write_page`, as a page.

To read the modules, begin with `crane_site` and `supervisor`, whose docstring says what is promised
and why it holds. Then `brakes`, `guard` and `working_wind` follow a crane, `capsules`,
`placed_capsules`, `distance_proof` and `obstacles` what is proven, and `site_simulation` a run.
`plan`, `shift_plan`, `operators` and `adversaries` are what a site is used for.

A cycle of the supervisor takes longer than its period where many boxes are close.
"""
