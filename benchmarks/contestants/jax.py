"""JAX on the processor: the equations of this one crane by hand, and MuJoCo's own engine for JAX,
MJX, on the same model; both in double precision, compiled for all cranes at once.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from benchmarks.contestants.mujoco import twin
from benchmarks.contestants.native import c_constants
from benchmarks.workload import Case, Contestant, Result, Run

Step = Callable[[Any, Any, Any], tuple[Any, Any]]
"""From coordinates, rates and efforts, a row for each of them with a place for each crane, to
those after a physics step."""


def _missing(module: str, package: str) -> str | None:
    """Return why a module that needs JAX cannot run here, None if it can."""
    if find_spec("jax") and (module == "jax" or find_spec(module)):
        return None
    return f"{package} is not installed: pip install 'cranedyn[peers]'"


def _looped(case: Case, step: Step) -> Run:
    """Control periods around a step, all of a run in one function that XLA compiles."""
    import jax
    import jax.numpy as jnp

    hold = case.controller
    drives = case.crane.layout.drives
    swings = case.crane.swings
    limit = case.crane.effort_limit[:, None]
    gains = [gain[:, None] for gain in (hold.feed_forward, hold.stiffness, hold.damping)]

    def period(setpoint: Any, _: Any, carried: Any) -> Any:
        q, v, peak = carried
        feed, stiffness, damping = gains
        command = feed + stiffness * (setpoint - q[drives]) - damping * v[drives]
        effort = jnp.clip(command, -limit, limit)

        def stepped(_: Any, state: tuple[Any, Any]) -> tuple[Any, Any]:
            return step(state[0], state[1], effort)

        q, v = jax.lax.fori_loop(0, case.steps, stepped, (q, v))
        return q, v, jnp.maximum(peak, (q[swings] ** 2).sum(axis=0))

    @jax.jit
    def periods(q: Any, v: Any, count: Any) -> Any:
        start = q, v, (q[swings] ** 2).sum(axis=0)
        return jax.lax.fori_loop(0, count, partial(period, q[drives]), start)

    def run(starts: np.ndarray, duration: float) -> Result:
        with jax.enable_x64(True):
            q, v, peak = periods(starts[:, :5].T, starts[:, 5:].T, case.periods(duration))
            return Result(np.vstack([q, v]).T.copy(), np.sqrt(np.asarray(peak)))

    return run


def _by_hand(case: Case) -> Run:
    """Return a run by the equations of `crane.c` on JAX arrays, one array for each variable."""
    import jax.numpy as jnp

    n = c_constants(case)
    dt = case.dt
    payload = n["PAYLOAD"]
    inner = n["INNER"]
    outer = n["OUTER"]
    damping = [n[f"DAMP_{name}"] for name in ("SLEW", "TROLLEY", "PHI", "THETA", "HOIST")]

    def step(q: Any, v: Any, effort: Any) -> tuple[Any, Any]:
        _, x, phi, theta, length = q
        slew, out, v1, v2, down = v
        sp = jnp.sin(phi)
        cp = jnp.cos(phi)
        st = jnp.sin(theta)
        ct = jnp.cos(theta)
        lever = length * ct
        offset = length * st
        across = down * st + length * v2 * ct
        plumb = down * ct - length * v2 * st
        radial = slew * (2.0 * across - slew * (x - lever * sp))
        aside = slew * (slew * offset + 2.0 * (out - sp * plumb - cp * lever * v1))
        below = sp * radial + cp * n["GRAVITY"] + lever * v1 * v1
        along = -ct * below - st * aside - length * v2 * v2
        across1 = payload * (sp * n["GRAVITY"] - cp * radial + 2.0 * v1 * plumb)
        across2 = payload * (st * below - ct * aside + 2.0 * down * v2)
        spin = inner * cp
        h1 = spin * v2 * slew - damping[2] * v1
        h2 = -spin * v1 * slew - damping[3] * v2
        d1 = payload * lever * lever + inner + outer
        d2 = payload * length * length + inner
        push1 = cp * ((inner + outer) * across1 / payload + lever * h1) * payload / d1
        push2 = (inner * across2 / payload + length * h2) * payload / d2
        share = payload * (inner + outer) / d1 * cp * cp
        share2 = payload * inner / d2
        tilt = st * sp
        hoist = effort[2] - damping[4] * down
        slewing = n["SLEWING"] + outer + inner * cp * cp + n["TROLLEY"] * x * x
        m_gg = slewing + share * offset * offset + share2 * (x * ct) ** 2
        m_gx = share * offset - share2 * x * ct * tilt
        m_xx = n["TROLLEY"] + share + share2 * tilt * tilt
        f_g = (effort[0] - damping[0] * slew - 2.0 * n["TROLLEY"] * x * slew * out) + (
            x * st * hoist + offset * push1 + x * ct * push2 - sp * h2 - spin * v1 * v2
        )
        f_x = (effort[1] - damping[1] * out + n["TROLLEY"] * x * slew * slew) + (
            ct * sp * hoist + push1 - tilt * push2
        )
        det = m_gg * m_xx - m_gx * m_gx
        a_g = (m_xx * f_g - m_gx * f_x) / det
        a_x = (m_gg * f_x - m_gx * f_g) / det
        a1 = (h1 - lever * (across1 - payload * cp * (offset * a_g + a_x))) / d1
        a2 = (h2 - length * (across2 + payload * (tilt * a_x - x * ct * a_g))) / d2 - sp * a_g
        a_l = hoist / payload + x * st * a_g + ct * sp * a_x - along
        v = v + dt * jnp.stack([a_g, a_x, a1, a2, a_l])
        return q + dt * v, v

    return _looped(case, step)


def _mjx(case: Case) -> Run:
    """Return a run of MuJoCo's model in MJX."""
    import jax
    from mujoco import mjx

    drives = case.crane.layout.drives
    with jax.enable_x64(True):
        model = mjx.put_model(twin(case.crane.urdf, gravity=case.crane.gravity, dt=case.dt))
        blank = mjx.make_data(model)

    def one(q: Any, v: Any, effort: Any) -> tuple[Any, Any]:
        applied = blank.qfrc_applied.at[drives].set(effort)
        after = mjx.step(model, blank.replace(qpos=q, qvel=v, qfrc_applied=applied))
        return after.qpos, after.qvel

    return _looped(case, jax.vmap(one, in_axes=1, out_axes=1))


CONTESTANTS = (
    Contestant("JAX by hand", lambda: _missing("jax", "jax"), _by_hand, many=True),
    Contestant("MJX", lambda: _missing("mujoco.mjx", "mujoco-mjx"), _mjx, many=True),
)
