"""Dynamics: joint forces, drives, integrators, linearisation, and where the model ceases to hold.

Pinocchio computes the motion of the bodies. What it does not have stands here, once, for any kind
of number (`scalars`): floats in the plain loop, symbols in an optimiser, values of compiled code.

Public names:
    `equations_of_motion`: acceleration, efforts, energy and positions at a state.
    `joint_forces.JointForces`, `joint_forces.Stops`: damping, springs and buffers.
    `integrators.Integrator`: a stepping rule; `semi_implicit_euler` and `rk4`.
    `converters.converters`: frequency converters of drives that take rates.
    `linearisation.linear`, `linearisation.free_modes`: linear models and modes.
    `validity.events`: when a run leaves ranges, slackens the rope or touches the ground.

Begin with `equations_of_motion` and `integrators`. The recursions for symbols and compiled code are
in `cranedyn.compiled.plant`.
"""
