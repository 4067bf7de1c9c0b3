"""Predictive control in code: a crane model over a horizon, its quadratic programme, and an
interior-point method with Riccati recursion.
"""
