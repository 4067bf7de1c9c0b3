"""Predictive control in code: a crane predicted over a horizon, the quadratic programme that comes
of it, and its solution by an interior-point method whose linear algebra is Riccati's.
"""
