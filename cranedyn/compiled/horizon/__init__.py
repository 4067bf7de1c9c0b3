"""Model predictive control of a crane in compiled code.

At each optimisation the controller linearises the crane along its last plan and solves a quadratic
programme over a horizon: a number of stages of equal length, over each of which the accelerations
of the drives are constant.

Begin with `receding.receding`: it makes a controller for a crane, which a run takes like any other.
The modules, from the controller down to the linear algebra:

* `receding`: the controller in Python, its weights, bounds and plausible readings.
* `control_instant`: what happens at a control instant: filters, the plan, and the command.
* `planning`: one optimisation: shift the last plan, linearise, solve, keep the new plan.
* `horizon_model`: the crane linearised about the nodes of a plan, and the weights of its states.
* `interior`: the interior-point method for the quadratic programme.
* `riccati`: its linear algebra, a recursion over the stages.
* `memory`: the parameters of a controller, the layout of its memory, and access to it in code.
* `dual`: numbers with derivatives.

All but `receding` and `dual` emit code for LLVM: their functions run once, with values of the code
under construction in place of numbers. The code computes in the order of the statements.
"""
