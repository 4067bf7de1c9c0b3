"""Who takes part: one module for each engine."""

from __future__ import annotations

from benchmarks.contestants import bullet, drake, mujoco, native, ours

CONTESTANTS = (
    *ours.CONTESTANTS,
    *mujoco.CONTESTANTS,
    *bullet.CONTESTANTS,
    *drake.CONTESTANTS,
    *native.CONTESTANTS,
)
"""All of them, in the order of the tables; those that cannot run here say why."""
