"""The plant in any kind of number: floats, rows of floats, symbols, values of compiled code.

The plain loop calls Pinocchio and needs nothing of this room. Compiled code, planning, lifting and
identification need the same physics in other kinds of numbers.

Public names:
    `rigid_body`: Newton-Euler, composite bodies and factorisation for a tree of bodies.
    `plant.Plant`: a crane with joint forces, drives, forces from outside and buffers.
    `plant.Topology`, `plant.numbers`: what cranes have in common, and what tells them apart.
    `cranes.load_cranes`: thousands of cranes for a batch, from a few that are loaded.

Begin with `rigid_body.tree_inverse_dynamics`, then `plant.Plant`.
"""
