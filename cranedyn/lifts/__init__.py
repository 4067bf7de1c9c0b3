"""Lifts on a building site: planned, judged, and simulated with several cranes at once.

Data goes one way through these packages:

* `planning` reads a site, finds a way for the load past all obstacles, moves it along in time,
  proves that nothing is touched, and returns a certificate. Begin with `planning.lift.plan_lift`.
* `judging` takes a certified lift and says whether it may go: loads, load chart, wind, and a page
  with every number. Begin with `judging.judgement.judge`.
* `sites` keeps several cranes apart: boxes, guards and a supervisor, and plans in space and time.
  Begin with `sites.site_simulation.simulate_site`.
* `tandem` lets two cranes of a site carry one load. Begin with `tandem.plan.plan_tandem`.
"""
