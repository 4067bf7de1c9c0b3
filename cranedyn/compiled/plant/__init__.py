"""The plant in any kind of number: floats, rows of floats, symbols, values of compiled code.

The plain loop calls Pinocchio and needs nothing of this room. Compiled code, planning, lifting and
identification need the same physics in other kinds of numbers.

Begin with `rigid_body.tree_inverse_dynamics`, then `plant.Plant`. The modules:

* `rigid_body`: Newton-Euler and composite bodies for a tree of bodies.
* `forward_dynamics`: accelerations of a tree, in fewer products where a load hangs on a rope.
* `plant`: a crane with joint forces, drives, external forces and buffers, `Plant`. A `Topology` is
  what cranes have in common, and `plant_numbers` is what tells them apart.
* `cranes`: thousands of cranes for a batch, from a few that are loaded, `load_cranes`.
"""
