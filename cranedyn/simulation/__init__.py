"""Runs of a crane under a controller: the loop, its log, and the engines that compute its steps.

Read in this order:

* `simulate`: a run from arguments to trajectory. `stepper`: the same, a control period at a time,
  for a loop of one's own. `stages`: runs in which the load changes.
* `run_spec`: the checked arguments of a run.
* `engine`: what an engine is; `pinocchio_engine`: the loop as one writes it by hand.
* `loop_checks`: what each control instant checks; `log`: its rows, and whether the model holds.
* `run_record`: what a trajectory says of its run.
"""
