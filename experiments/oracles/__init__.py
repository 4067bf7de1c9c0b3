"""Closed forms beside runs of the plant: each module has one part of mechanics, `check` judges them
all.
"""
