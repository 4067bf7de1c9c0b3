"""Primal-dual interior-point method in code, for bounds that may be exceeded at a price.

Each number y of a stage has bounds low <= y <= high. To exceed one by s costs price s, so that
there is always a solution, and a bound holds wherever this costs less than the price. Of one bound,

* g is the room to it, high - y or y - low, negative where it is exceeded;
* t >= 0 is the slack and s >= 0 the excess, with t - s = g;
* λ >= 0 is the multiplier of t, and ν = price - λ >= 0 that of s.

At the optimum t λ = 0 and s ν = 0. The central path t λ = s ν = μ leads there as the barrier μ goes
to zero. A step of Newton's method towards the point of the path at μ satisfies

    λ Δt + t Δλ = μ - t λ - Δt Δλ
    ν Δs - s Δλ = μ - s ν - Δs Δν,    Δν = -Δλ,    t + Δt - s - Δs = g of the new y,

where the products of steps are those of a first step without them, the predictor. Elimination of Δt
and Δs gives a multiplier step that is linear in the room g of the new y:

    Δλ = k (b - g),    k = 1 / (t/λ + s/ν) = λ ν / (t ν + s λ),
    b = (μ - Δt Δλ) / λ - (μ - Δs Δν) / ν.

So each bound acts on y as a spring of the stiffness k that is slack where the room is b, the *aim*;
and what is left is a quadratic programme
without bounds, which `cranedyn.compiled.horizon.riccati` solves. Predictor and corrector are those
of Mehrotra (1992), "On the implementation of a primal-dual interior point method".

Names in memory: t `slack`, s `excess`, λ `multiplier`, ν `excess_multiplier`, 1/λ and 1/ν
`inverse_multiplier` and `inverse_excess_multiplier`, k `stiffness`, Δt `slack_step`, Δs
`excess_step`, Δλ `multiplier_step`. Between predictor and corrector the rows of the first two steps
hold the products Δt Δλ and Δs Δν.
"""

from __future__ import annotations

from operator import add
from typing import Any

from llvmlite import ir

from cranedyn.compiled.code import StackVariable, Value
from cranedyn.compiled.horizon.memory import Constants, HorizonShape, MemoryRows, Work
from cranedyn.dynamics.scalars import larger

_MAX_ITERATIONS = 20
"""Largest number of iterations."""

_STEP_SHARE = 0.995
"""Largest step, as a share of the step at which a slack or a multiplier would be zero."""

_GAP_TOLERANCE = 1e-8
"""Tolerance of the mean product of slacks and multipliers, as a share of the initial barrier."""

_RESIDUAL_TOLERANCE = 1e-9
"""Tolerance of the residual of the gradient, as a share of the initial one."""

_SIGNS = {"high": 1.0, "low": -1.0}
"""Sign with which the multiplier of each bound enters the gradient."""


def emit(module: ir.Module, shape: HorizonShape, constants: Constants | None = None) -> None:
    """Add the function `solve`, from model, gradient and bounds of the stages to the optimum.

    Args:
        module: Module to which it is added; it has the functions of `riccati.emit`.
        shape: Dimensions of the programme.
        constants: Numbers that are the same in every stage.
    """
    _Solve(Work(module, "solve", shape, constants)).emit()


class _Solve:
    """The function `solve` under construction."""

    def __init__(self, work: Work) -> None:
        self.work = work
        self.code = work.code
        self.wide = work.wide
        self.shape = work.shape

    def emit(self) -> None:
        """Emit the whole function."""
        code = self.code
        work = self.work
        self._solve_without_bounds()
        # Where that exceeds no bound, it is the optimum.
        is_bounded = work.reported("excess") > 0.0
        work.put_report("solved", code.where(is_bounded, 0.0, 1.0))
        work.put_report("iterations", 0.0)
        with code.when(code.anywhere(is_bounded)):
            self._start_on_central_path(is_bounded)
            barrier = work.reported("barrier")
            gap, residual = code.variables([barrier, 1.0])
            # Once solved, a lane takes steps of 0 until the others are.
            with (
                code.loop(0, _MAX_ITERATIONS),
                code.when(code.anywhere(work.reported("solved") < 0.5)),
            ):
                self._iterate(barrier, gap, residual)
        code.end()

    def _iterate(self, barrier: Value, gap: StackVariable, residual: StackVariable) -> None:
        """Take a step, and report what it has reached.

        Args:
            barrier: Initial barrier.
            gap: Mean product of slacks and multipliers.
            residual: Residual of the gradient, as a share of the initial one.
        """
        code = self.code
        work = self.work
        is_unsolved = work.reported("solved") < 0.5
        step = code.where(is_unsolved, self._prepare_step(gap.get()), 0.0)
        gap.set(self._take_step(step))
        # The gradient is linear in values and multipliers: a share of the step removes that share
        # of its residual.
        residual.set(residual.get() * (1.0 - step))
        iterations = work.reported("iterations") + code.where(is_unsolved, 1.0, 0.0)
        has_small_gap = gap.get() < _GAP_TOLERANCE * barrier
        has_small_residual = residual.get() < _RESIDUAL_TOLERANCE
        is_done = code.both(has_small_gap, has_small_residual)
        solved = code.where(is_done, 1.0, work.reported("solved"))
        last_gap = gap.get()
        last_residual = residual.get()
        work.put_report("solved", solved)
        work.put_report("iterations", iterations)
        work.put_report("gap", last_gap)
        work.put_report("residual", last_residual)

    def _solve_without_bounds(self) -> None:
        """Solve without bounds, and report the largest excess of a bound."""
        work = self.work
        work.call("free")
        work.call("sweep")
        (worst,) = self.wide.variables([-1.0])
        with work.each_vector() as vector:
            trial = vector.rows.get("trial")
            vector.rows.put("iterate", trial)
            above = trial - vector.shared.get("high")
            below = vector.shared.get("low") - trial
            self._update_largest(worst, [above, below])
        work.put_report("excess", work.reduce_lanes(worst.get(), larger))

    def _start_on_central_path(self, is_bounded: ir.Value) -> None:
        """Start at the nodes of linearisation, with slacks and multipliers on the central path.

        With d = μ / price, the equations t λ = s ν = μ, λ + ν = price and t - s = g give
        (t - d) (s - d) = d², and from that t = d + (√(g² + 4 d²) + g) / 2 and
        s = d + (√(g² + 4 d²) - g) / 2.
        """
        work = self.work
        wide = self.wide
        variables = self.shape.variables
        inputs = self.shape.inputs
        with work.code.loop(0, self.shape.stages) as k:
            rows = work.stage(k)
            node = rows.row("node", variables)
            further = rows.table("extra", variables) @ node
            further = further + rows.row("extra_shift", inputs, first=variables)
            rows.put_row("trial", [*node, *further])
        barrier = work.in_all_lanes(work.reported("barrier"))
        begins = work.in_all_lanes(self.code.where(is_bounded, 1.0, 0.0)) > 0.5
        with work.each_vector() as vector:
            rows = vector.rows
            node = rows.get("trial")
            softness = barrier / vector.shared.get("price")
            rows.put("iterate", wide.where(begins, node, rows.get("iterate")))
            for side in _SIGNS:
                room = self._room(node, side, vector.shared)
                root = wide.call("llvm.sqrt", room * room + 4.0 * (softness * softness))
                slack = softness + 0.5 * (root + room)
                excess = softness + 0.5 * (root - room)
                rows.put(f"slack_{side}", slack)
                rows.put(f"excess_{side}", excess)
                rows.put(f"multiplier_{side}", barrier / slack)
                rows.put(f"excess_multiplier_{side}", barrier / excess)
            self._put_springs(rows, vector.shared)

    def _room(self, value: Value, side: str, shared: MemoryRows) -> Value:
        """Return the room g of a value to a bound, negative where it exceeds it."""
        bound = shared.get(side)
        return bound - value if side == "high" else value - bound

    def _prepare_step(self, gap: Value) -> Value:
        """Compute the step of an iteration, and return the share of it that keeps slacks and
        multipliers positive.

        Args:
            gap: Mean product of slacks and multipliers.
        """
        work = self.work
        wide = self.wide
        work.call("factor")
        work.call("sweep")
        ratio, products = wide.variables([1.0, 0.0])
        with work.each_vector() as vector:
            self._predict(vector.rows, vector.shared, ratio, products)

        # With a share α of the predictor, which aims at μ = 0, a product t λ becomes
        # (1 - α) t λ + α² Δt Δλ. The smaller their mean would be, the better the predictor, and the
        # smaller the barrier at which the corrector aims: that share of the gap to the third power.
        step = 1.0 / work.reduce_lanes(ratio.get(), larger)
        predicted = (gap * (1.0 - step) + self._mean(products) * (step * step)) / gap
        centred = work.in_all_lanes(gap * (predicted * predicted * predicted))
        with work.each_vector() as vector:
            aims = {side: self._aim(vector.rows, side, centred) for side in _SIGNS}
            self._put_gradient(vector.rows, vector.shared, aims)
        work.call("sweep")
        (ratio,) = wide.variables([_STEP_SHARE])
        with work.each_vector() as vector:
            self._correct(vector.rows, vector.shared, centred, ratio)
        return _STEP_SHARE / work.reduce_lanes(ratio.get(), larger)

    def _put_springs(self, rows: MemoryRows, shared: MemoryRows) -> None:
        """Store the springs of the bounds, and the gradient for the predictor."""
        for side in _SIGNS:
            multiplier = rows.get(f"multiplier_{side}")
            excess_multiplier = rows.get(f"excess_multiplier_{side}")
            product = multiplier * excess_multiplier
            slack_part = rows.get(f"slack_{side}") * excess_multiplier
            excess_part = rows.get(f"excess_{side}") * multiplier
            weighted_slacks = slack_part + excess_part
            # One division, which takes long, for three quotients: of λ ν (t ν + s λ).
            inverse = 1.0 / (product * weighted_slacks)
            rows.put(f"inverse_multiplier_{side}", excess_multiplier * (weighted_slacks * inverse))
            rows.put(f"inverse_excess_multiplier_{side}", multiplier * (weighted_slacks * inverse))
            rows.put(f"stiffness_{side}", product * (product * inverse))
        rows.put("barrier_curvature", rows.get("stiffness_high") + rows.get("stiffness_low"))
        self._put_gradient(rows, shared, {side: 0.0 for side in _SIGNS})

    def _put_gradient(self, rows: MemoryRows, shared: MemoryRows, aims: dict[str, Any]) -> None:
        """Store the gradient of cost and bounds by all bounded quantities y, where states and
        inputs are zero.

        A bound contributes ± (λ + Δλ) = ± (λ + k (b - g)), with g = high - y or y - low. Where
        states and inputs are zero, y is `extra_shift`, which is zero for these themselves.

        Args:
            rows: Rows of the stage.
            shared: Rows that all stages share.
            aims: The number b of the upper and of the lower bounds; 0 for the predictor.
        """
        gradient = rows.get("gradient") + rows.get("barrier_curvature") * rows.get("extra_shift")
        for side, sign in _SIGNS.items():
            # At y = 0 the room is `high` or `-low`.
            room_beyond_aim = sign * shared.get(side) - aims[side]
            force = rows.get(f"multiplier_{side}") - rows.get(f"stiffness_{side}") * room_beyond_aim
            gradient = gradient + sign * force
        rows.put("total_gradient", gradient)

    def _predict(
        self, rows: MemoryRows, shared: MemoryRows, ratio: StackVariable, products: StackVariable
    ) -> None:
        """Compute the predictor, which aims at the bounds themselves: μ = 0 and b = 0.

        Args:
            rows: Rows of the stage.
            shared: Rows that all stages share.
            ratio: Largest ratio of a decrease to what decreases, t, s, λ or ν; it grows.
            products: Sum of the products Δt Δλ and Δs Δν; it is continued.
        """
        candidates = []
        total = products.get()
        for side in _SIGNS:
            stiffness = rows.get(f"stiffness_{side}")
            multiplier_step = -(stiffness * self._room(rows.get("trial"), side, shared))
            # Δλ/λ and Δλ/ν; from them follow Δt/t = -(1 + Δλ/λ) and Δs/s = -(1 - Δλ/ν).
            by_multiplier = multiplier_step * rows.get(f"inverse_multiplier_{side}")
            by_excess_multiplier = multiplier_step * rows.get(f"inverse_excess_multiplier_{side}")
            slack_step = -(rows.get(f"slack_{side}") * (1.0 + by_multiplier))
            excess_step = -(rows.get(f"excess_{side}") * (1.0 - by_excess_multiplier))
            candidates.append(-by_multiplier)
            candidates.append(1.0 + by_multiplier)
            candidates.append(by_excess_multiplier)
            candidates.append(1.0 - by_excess_multiplier)
            product = multiplier_step * slack_step
            excess_product = -(multiplier_step * excess_step)
            rows.put(f"slack_step_{side}", product)
            rows.put(f"excess_step_{side}", excess_product)
            total = total + (product + excess_product)
        self._update_largest(ratio, candidates)
        products.set(total)

    def _aim(self, rows: MemoryRows, side: str, centred: Value) -> Any:
        """Return b of the corrector, which aims at the point of the central path at the barrier
        `centred`, to second order: (μ - Δt Δλ) / λ - (μ - Δs Δν) / ν.
        """
        slack_part = (centred - rows.get(f"slack_step_{side}")) * rows.get(
            f"inverse_multiplier_{side}"
        )
        excess_part = (centred - rows.get(f"excess_step_{side}")) * rows.get(
            f"inverse_excess_multiplier_{side}"
        )
        return slack_part - excess_part

    def _correct(
        self, rows: MemoryRows, shared: MemoryRows, centred: Value, ratio: StackVariable
    ) -> None:
        """Compute the combined step of predictor and corrector.

        Args:
            rows: Rows of the stage.
            shared: Rows that all stages share.
            centred: Barrier of the point of the central path at which it aims.
            ratio: Largest ratio of a decrease to what decreases, t, s, λ or ν; it grows.
        """
        candidates = []
        for side in _SIGNS:
            inverse_multiplier = rows.get(f"inverse_multiplier_{side}")
            inverse_excess_multiplier = rows.get(f"inverse_excess_multiplier_{side}")
            slack = rows.get(f"slack_{side}")
            excess = rows.get(f"excess_{side}")
            room = self._room(rows.get("trial"), side, shared)
            stiffness = rows.get(f"stiffness_{side}")
            multiplier_step = stiffness * (self._aim(rows, side, centred) - room)
            by_multiplier = multiplier_step * inverse_multiplier
            by_excess_multiplier = multiplier_step * inverse_excess_multiplier
            # Δt = (μ - Δt Δλ)/λ - t (1 + Δλ/λ) with the product of the predictor; Δs likewise.
            slack_aim = (centred - rows.get(f"slack_step_{side}")) * inverse_multiplier
            slack_step = slack_aim - slack * (1.0 + by_multiplier)
            excess_aim = (centred - rows.get(f"excess_step_{side}")) * inverse_excess_multiplier
            excess_step = excess_aim - excess * (1.0 - by_excess_multiplier)
            inverse = 1.0 / (slack * excess)  # one division for two quotients
            slack_ratio = -(slack_step * excess * inverse)
            excess_ratio = -(excess_step * slack * inverse)
            candidates.append(-by_multiplier)
            candidates.append(by_excess_multiplier)
            candidates.append(slack_ratio)
            candidates.append(excess_ratio)
            rows.put(f"multiplier_step_{side}", multiplier_step)
            rows.put(f"slack_step_{side}", slack_step)
            rows.put(f"excess_step_{side}", excess_step)
        self._update_largest(ratio, candidates)

    def _update_largest(self, largest: StackVariable, candidates: list[Value]) -> None:
        """Replace a variable by the largest of it and candidates.

        The candidates are compared first, so that after the last value of the variable is known,
        only one operation is left: each pass of a loop waits for that of the pass before.
        """
        present = largest.get()
        largest_candidate = candidates[0]
        for candidate in candidates[1:]:
            largest_candidate = larger(largest_candidate, candidate)
        largest.set(larger(present, largest_candidate))

    def _take_step(self, share: Value) -> Value:
        """Take a share of the step, and return the mean product of slacks and multipliers there."""
        work = self.work
        wide = self.wide
        share = work.in_all_lanes(share)
        (products,) = wide.variables([0.0])
        with work.each_vector() as vector:
            rows = vector.rows
            iterate = rows.get("iterate")
            moved = iterate + share * (rows.get("trial") - iterate)
            # Without a step the iterate stays even where the trial point is not finite.
            rows.put("iterate", wide.where(share > 0.0, moved, iterate))
            for side in _SIGNS:
                multiplier_step = share * rows.get(f"multiplier_step_{side}")
                multiplier = rows.get(f"multiplier_{side}") + multiplier_step
                excess_multiplier = rows.get(f"excess_multiplier_{side}") - multiplier_step
                slack = rows.get(f"slack_{side}") + share * rows.get(f"slack_step_{side}")
                excess = rows.get(f"excess_{side}") + share * rows.get(f"excess_step_{side}")
                rows.put(f"multiplier_{side}", multiplier)
                rows.put(f"excess_multiplier_{side}", excess_multiplier)
                rows.put(f"slack_{side}", slack)
                rows.put(f"excess_{side}", excess)
                products.set(products.get() + (multiplier * slack + excess_multiplier * excess))
            self._put_springs(rows, vector.shared)
        return self._mean(products)

    def _mean(self, products: StackVariable) -> Value:
        """Return the mean of a sum over all bounds: two sides, each with a slack and an excess."""
        count = 4.0 * self.shape.stages * self.shape.row_length
        return self.work.reduce_lanes(products.get(), add) * (1.0 / count)
