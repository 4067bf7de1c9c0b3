"""Cranes of other topology than the tower crane of five joints: what they are, and what is asked of
each.
"""
