"""How a crane moves: bodies, joint forces, drives, integrators, and where the model ceases to
hold.
"""
