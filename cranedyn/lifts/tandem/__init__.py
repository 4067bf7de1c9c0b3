"""Two cranes that carry one load on two ropes.

    from cranedyn.lifts.tandem.load import TandemLoad, TandemRope
    from cranedyn.lifts.tandem.plan import TandemLift, plan_tandem
    from cranedyn.lifts.tandem.simulation import simulate_tandem
    from cranedyn.lifts.tandem.yard import tandem_yard

    beam = TandemLoad(4000.0, (15.0, 0.6, 0.8), lugs=((-7.0, 0.0, 0.4), (7.0, 0.0, 0.4)))
    lift = TandemLift(tandem_yard(), ("north", "south"), beam, TandemRope(2e7, damping=2e4))
    plan = plan_tandem(lift, (0.0, -32.0, 5.0), (4.0, -32.0, 9.0), yaw=-1.5708)
    run = simulate_tandem(lift, plan)
    print(run.largest_shares)

Public names:

* `load.TandemLoad` is the load, a rigid body with six degrees of freedom; `load.TandemRope` a rope
  that stretches and may go slack.
* `plan.plan_tandem` moves the load along a line without swing, and returns how the drives of both
  cranes have to move.
* `drives.TandemDrives` are those motions; `delayed` and `stopped` change them to those of drives
  that are not synchronised, or of which one stops.
* `simulation.simulate_tandem` moves the load under both ropes, and returns a `TandemRun`.
* `recording.record_tandem` shows a run in 3D.
* `statics` has the shares of the load in closed form, `rules` how far codes of practice reduce the
  rated loads of two cranes, and `judgement.judge_tandem` compares a run with both.
"""
