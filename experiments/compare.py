"""Compare: every strategy for a move beside every other, as planned and when load, cable, sensors
and air are not as planned.
"""

from __future__ import annotations

import argparse
import gc
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from multiprocessing import active_children, get_context
from typing import Any, NamedTuple

import numpy as np

from cranedyn.command import interrupted
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.converters import converters
from cranedyn.errors import CraneError, number
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.sweep.workers import end_with_parent, ignore_sigint
from experiments import harness
from experiments.compare_figures import robustness_figure, swing_figure
from experiments.compare_observers import observer_claims, observer_table
from experiments.scenarios.colours import strategy_colour
from experiments.scenarios.moves import (
    AFTER,
    CLOSE,
    DWELL,
    LIMITS,
    MOVES,
    SWINGING,
    TOUR_LIMITS,
    Move,
    Score,
    of_sampling,
    residual,
)
from experiments.scenarios.perturbations import (
    AFTER_UNTOLD,
    NOMINAL,
    PERTURBATIONS,
    UNOBSERVED,
    UNTOLD,
    make,
)
from experiments.scenarios.strategies import (
    COMPILED_MPC,
    FASTEST,
    FLAT,
    MPC,
    PAPER,
    PD,
    STRATEGIES,
    SWING,
    TIME,
    TO_GOAL,
    mpc_period,
    on_converters,
)
from experiments.scenarios.tours import CONTROLS

COMBINED = MOVES[-1]

UNSEEING = "it does not look at the swing"

IDEAL = "ideal"
"""Drives that take what each strategy answers."""

RESOLUTION = {IDEAL: (">0.001", ">0.01"), "velocity": (">0.1", ">1")}
"""Least swing [mrad] and way of the hook [mm] that are told apart, by drives. Rates of converters
come in 1/16384 of the largest, and one such step of the trolley's or slew's rate swings a load on
15 m by 0.009 mrad; a dozen of them in step with the swing, as rounding may have it, are 0.1 mrad.
On ideal drives the control period leaves some 0.001 mrad."""

PREDICTIVE = (MPC, COMPILED_MPC, TO_GOAL)
"""Strategies whose time to compute is noted."""

RECORDED = (PD, PAPER, FLAT, TIME)
"""Strategies that are drawn into each other in the recording."""


class Result(NamedTuple):
    """What came of a strategy under a case: its score, or why there is none."""

    score: Score | None
    why: str = ""
    run: Trajectory | None = None
    calls: np.ndarray = np.empty(0)


Results = dict[str, dict[str, Result]]
"""By strategy, then by case."""


def experiment(options: argparse.Namespace, setup: harness.Setup) -> harness.Outcome:
    """Make every move by every strategy, the combined one under every case, and the tour."""
    from cranedyn.recording import Run

    strategies, drive = options.only or list(STRATEGIES), options.drive
    ideal = drive == IDEAL
    alone = replace(setup, reporter=harness.ProgressReporter(None))
    moves = [*MOVES, SWINGING]
    with _workers(options.jobs) as workers:
        tasks: dict[Future[dict[str, Result]], tuple[Move, str]] = {}
        tours: dict[Future[Toured | str], str] = {}
        with ignore_sigint():  # submitting starts processes
            for move in moves:
                for strategy in strategies:
                    all_cases = move == COMBINED
                    task = workers.submit(_made, alone, move, strategy, all_cases, drive)
                    tasks[task] = move, strategy
            for control in CONTROLS if ideal else ():
                tours[workers.submit(_toured, alone, control)] = control
        update = setup.reporter.count("comparison", len(tasks) + len(tours))
        everything: list[Future[Any]] = [*tasks, *tours]
        for done, _ in enumerate(as_completed(everything), start=1):
            update(done)
    of_move: dict[str, Results] = {move.name: {} for move in moves}
    for task, (move, strategy) in tasks.items():
        of_move[move.name][strategy] = task.result()
    combined = of_move[COMBINED.name]
    runs = {strategy: found[NOMINAL.name].run for strategy, found in combined.items()}
    kept = {strategy: run for strategy, run in runs.items() if run is not None}
    return harness.Outcome(
        tables=[
            *(_table(move, of_move[move.name], drive) for move in moves),
            *(_drives_table(move, of_move[move.name], beyond=not ideal) for move in moves),
            *([_tour_table({control: task.result() for task, control in tours.items()})] * ideal),
            *_case_tables(_perturbed(combined), drive),
            *([observer_table(combined)] * ideal),
        ],
        claims=[
            *(_claims(setup, combined) if ideal else _claims_of_converters(of_move)),
            *(observer_claims(combined) if ideal else ()),
            *_in_time(setup, of_move.values()),
        ],
        parameters=setup.parameters()
        | {
            "rate_limits": list(LIMITS.rates),
            "acceleration_limits": list(LIMITS.accelerations),
            "moves": {
                move.name: [move.start, move.goal, move.duration, move.swing] for move in moves
            },
        }
        | ({} if ideal else _numbers_of_converters(setup)),
        trajectories={f"compare_{_plain(strategy)}": run for strategy, run in kept.items()},
        figures={
            "swing": swing_figure(COMBINED, kept),
            "robustness": robustness_figure(_perturbed(combined)),
        },
        recording=[
            Run(s, setup.crane, kept[s], colour=strategy_colour(s)) for s in drawn(list(kept))
        ],
    )


def drawn(strategies: Sequence[str]) -> Sequence[str]:
    """Which of some strategies are drawn into each other in the recording: those of `RECORDED`, or
    as many of the others if none of these is there.
    """
    return [one for one in RECORDED if one in strategies] or strategies[: len(RECORDED)]


@contextmanager
def _workers(jobs: int | None) -> Iterator[ProcessPoolExecutor]:
    """Processes that end with the context, whatever ends it, and with this process, even if that is
    killed.
    """
    if jobs is not None:
        number("jobs", jobs, "", "1 to 1024")
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=end_with_parent)
    try:
        yield pool
    except BaseException as error:
        for child in active_children():
            child.terminate()
        if isinstance(error, BrokenProcessPool):
            raise CraneError(
                "A process of the comparison was ended from outside; what it had done is lost."
            ) from None
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _made(
    setup: harness.Setup, move: Move, strategy: str, all_cases: bool, drive: str = IDEAL
) -> dict[str, Result]:
    """A move by one strategy, as planned and perhaps under every case; what breaks off or cannot be
    is told, not raised.
    """
    try:
        plan = STRATEGIES[strategy](setup, move)
        if drive != IDEAL:
            plan = on_converters(setup, plan)
    except CraneError as error:
        return {NOMINAL.name: Result(None, str(error))}
    found = {}
    cases = (*PERTURBATIONS, *(UNTOLD if drive == IDEAL else ())) if all_cases else (NOMINAL,)
    for case in cases:
        if case.sensors_only and not plan.uses_swing_sensor:
            found[case.name] = Result(None, UNSEEING)
            continue
        calls: list[float] = []
        noted = (
            plan._replace(controller=partial(_timed, plan.controller, calls))
            if strategy in PREDICTIVE and case not in UNTOLD
            else plan
        )
        try:
            with collector_waits(noted is not plan):
                run, scored = make(
                    setup, move, noted, case, after=AFTER_UNTOLD if case in UNTOLD else AFTER
                )
            found[case.name] = Result(
                scored, "", run if case == NOMINAL and all_cases else None, np.array(calls)
            )
        except CraneError as error:
            if interrupted(error):
                raise KeyboardInterrupt from None
            found[case.name] = Result(None, str(error))
    return found


@contextmanager
def collector_waits(timed: bool) -> Iterator[None]:
    """Have Python's garbage collected after a run that is timed, not in its midst: to go through
    all that a process holds takes 0.15 s, which would be counted as the controller's.
    """
    collects = gc.isenabled()
    if timed:
        gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def _timed(make_controller: Callable[[], Controller], calls: list[float]) -> Controller:
    """A controller that notes the processor time of each call [s], to which other work of the
    machine adds nothing.
    """
    controller = make_controller()

    def timed(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        began = time.thread_time()
        command = controller(t, state, setpoint)
        calls.append(time.thread_time() - began)
        return command

    return timed


class Toured(NamedTuple):
    """The seven legs under one control: length of the cycle [s], swing left in the dwells [mrad],
    at the hook [mm], on the way [mrad].
    """

    cycle: float
    worst: float
    mean: float
    hook: float
    peak: float


def _toured(setup: harness.Setup, control: str) -> Toured | str:
    """The seven legs under one control, or why not."""
    try:
        return _tour(setup, control)
    except CraneError as error:
        if interrupted(error):
            raise KeyboardInterrupt from None
        return str(error)


def _tour(setup: harness.Setup, control: str) -> Toured:
    reference, controller = CONTROLS[control](setup, TOUR_LIMITS, DWELL)
    duration = setup.control_period * round(reference.duration / setup.control_period)
    run = setup.simulate(
        setup.crane, controller, reference, start=setup.crane.start, duration=duration, label=""
    )
    rests = [run.between(stage.arrival, stage.end) for stage in reference.stages]
    left = [1000.0 * residual(rest) for rest in rests]
    hook = max(swing * float(rest["l_m"][-1]) for swing, rest in zip(left, rests, strict=True))
    return Toured(
        duration,
        max(left),
        float(np.mean(left)),
        hook,
        1000.0 * float(np.linalg.norm(run.coordinates("phi", "theta"), axis=1).max()),
    )


def _perturbed(found: Results) -> Results:
    """What came of the cases of `PERTURBATIONS`."""
    names = [case.name for case in PERTURBATIONS]
    return {
        strategy: {name: results[name] for name in names if name in results}
        for strategy, results in found.items()
    }


def _plain(strategy: str) -> str:
    return strategy.replace("'s", "").replace(" + ", "_").replace(" ", "_").lower()


def _numbers_of_converters(setup: harness.Setup) -> dict[str, object]:
    made = converters(setup.crane)
    rows = {name: part.tolist() for name, part in made.response._asdict().items()}
    return {"drive": "velocity", "converters": rows | {"delay_s": made.delay}}


def _seconds(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _reasons(results: Mapping[str, Result]) -> str:
    """Why some have no numbers, each reason once."""
    reasons: dict[str, list[str]] = {}
    for name, result in results.items():
        if result.why:
            reasons.setdefault(result.why, []).append(name)
    return "".join(f" {', '.join(names)}: {why}" for why, names in reasons.items())


def _table(move: Move, found: Results, drive: str) -> harness.Table:
    rounded, hook = RESOLUTION[drive]
    columns = [
        ("strategy", ""),
        ("arrives [s]", ".2f"),
        ("peak [mrad]", ".1f"),
        ("at arrival [mrad]", f".3g{rounded}"),
        ("hook [mm]", f".4g{hook}"),
    ]
    columns += [
        ("20 s later [mrad]", f".3g{rounded}"),
        ("settled [s]", ".2f"),
        ("cycle [s]", ".2f"),
    ]
    nominal = {strategy: results[NOMINAL.name] for strategy, results in found.items()}
    rows = [
        (
            strategy,
            s.arrives,
            1e3 * s.peak,
            1e3 * s.arrival,
            1e3 * s.arrival * s.length,
            1e3 * s.later,
            _seconds(s.settled),
            _seconds(s.cycle),
        )
        if s
        else (strategy, *[None] * 7)
        for strategy, s in ((strategy, result.score) for strategy, result in nominal.items())
    ]
    note = (
        "Amplitudes of the swing; hook: the same at the hook on arrival; settled: time after it "
        "from which the payload stays within 10 mm "
        "of its goal, a dash where it does not in 20 s; cycle: from the start until "
        f"then.{_quantised(drive)}{_reasons(nominal)}"
    )
    return harness.Table(f"Move {move.name}: {move.start} to {move.goal}", columns, rows, note)


def _drives_table(move: Move, found: Results, *, beyond: bool = False) -> harness.Table:
    """What a move asks of the drives; where they are asked for more than they have, or `beyond`,
    for how long.
    """
    names = [
        f"{drive} {kind} [{unit}]"
        for kind in ("peak", "RMS")
        for drive, unit in (("T_γ", "kN m"), ("F_x", "kN"), ("F_l", "kN"))
    ]
    nominal = [results[NOMINAL.name].score for results in found.values()]
    beyond = beyond or any(s and s.beyond for s in nominal)
    rows = [
        (
            strategy,
            *(1e-3 * s.effort).tolist(),
            *(1e-3 * s.rms).tolist(),
            1e-3 * s.work,
            s.rate,
            s.acceleration,
            *([s.beyond] if beyond else []),
        )
        for strategy, s in (
            (strategy, results[NOMINAL.name].score) for strategy, results in found.items()
        )
        if s
    ]
    note = (
        "Efforts beyond holding the load at rest; work: what the drives put in, not counting what "
        "they took back; rate, acc.: largest rate "
        "and acceleration as a share of the limits that the plans keep. Feedback is limited by "
        "effort only."
    )
    columns = [
        ("strategy", ""),
        *((name, ".2f") for name in names),
        ("work [kJ]", ".1f"),
        ("rate", ".2f"),
        ("acc.", ".2f"),
    ]
    if beyond:
        columns.append(("beyond [s]", ".2f"))
        note += (
            " Beyond: time in which drives that follow a motion or a rate were asked for more "
            "effort or rate than they have."
        )
    return harness.Table(f"What move {move.name} asks of the drives", columns, rows, note)


def _tour_table(tours: Mapping[str, Toured | str]) -> harness.Table:
    columns = [
        ("control", ""),
        ("cycle [s]", ".1f"),
        ("worst dwell [mrad]", f".4g{RESOLUTION[IDEAL][0]}"),
        ("mean of dwells [mrad]", f".4g{RESOLUTION[IDEAL][0]}"),
    ]
    columns += [
        ("worst at the hook [mm]", f".4g{RESOLUTION[IDEAL][1]}"),
        ("peak on the way [mrad]", ".1f"),
    ]
    rows = [
        (control, *([None] * 5 if isinstance(found, str) else found))
        for control, found in tours.items()
    ]
    reasons = "".join(
        f" {control}: {found}" for control, found in tours.items() if isinstance(found, str)
    )
    note = f"Half the way across, radial and tangential together.{reasons}"
    return harness.Table("The article's seven legs as one tour", columns, rows, note)


def _case_tables(found: Results, drive: str) -> Iterator[harness.Table]:
    for title, value, rounded, note in (
        (
            "Swing 20 s after the arrival [mrad], combined move",
            lambda s: 1e3 * s.later,
            RESOLUTION[drive][0],
            _quantised(drive),
        ),
        (
            "Settled within 10 mm [s after the arrival], combined move",
            lambda s: _seconds(s.settled),
            "",
            "",
        ),
    ):
        columns = [("strategy", ""), *((case.name, f".3g{rounded}") for case in PERTURBATIONS)]
        rows = [
            (
                strategy,
                *(
                    value(r.score) if (r := results.get(case.name)) and r.score else None
                    for case in PERTURBATIONS
                ),
            )
            for strategy, results in found.items()
        ]
        reasons = _reasons(
            {
                f"{strategy}, {case}": r
                for strategy, results in found.items()
                for case, r in results.items()
                if r.why != UNSEEING
            }
        )
        dash = "A dash: it does not look at the swing, or does not settle in 20 s, or breaks off."
        yield harness.Table(title, columns, rows, f"{dash}{note}{reasons}")


def _quantised(drive: str) -> str:
    """Return why small swings are not told apart, nothing where drives are ideal."""
    if drive == IDEAL:
        return ""
    return " Less than 0.1 mrad is decided by the rounding of the rates that converters take."


def _claims(setup: harness.Setup, found: Results) -> list[harness.Claim]:
    def score(strategy: str, case: str = NOMINAL.name) -> Score | None:
        result = found.get(strategy, {}).get(case)
        return result.score if result else None

    claims = []
    flat, shortest = score(FLAT), score(TIME)
    if flat:
        sampling = of_sampling(setup.gravity, flat.length, setup.control_period, flat.peak)
        claims.append(
            harness.Claim(
                f"On arrival flat paths with LQR leave no swing: {1e3 * flat.arrival:.4f} mrad, "
                "where efforts that are held for "
                f"{1e3 * setup.control_period:g} ms may leave {1e3 * sampling:.4f} mrad.",
                flat.arrival < sampling,
            )
        )
    loads = [s for case in ("load -50 %", "load +50 %") if (s := score(FLAT, case))]
    if loads:
        slowest = max(s.settled for s in loads)
        claims.append(
            harness.Claim(
                "With half or one and a half of the load they settle within a second of the "
                f"arrival ({slowest:.2f} s).",
                slowest < 1.0,
            )
        )
    others = {
        strategy: s.cycle for strategy in found if strategy != TIME and (s := score(strategy))
    }
    if shortest and FASTEST in others:
        second = min(others, key=lambda strategy: others[strategy])
        claims.append(
            harness.Claim(
                "Under the same limits the move of least time settles before any other "
                f"({shortest.cycle:.2f} s; next is {second} after "
                f"{others[second]:.2f} s).",
                shortest.cycle < others[second],
            )
        )
    return claims


def _claims_of_converters(of_move: Mapping[str, Results]) -> list[harness.Claim]:
    """Whether an LQR about the planned path of the load arrives with it on converters, in every
    move and case.
    """
    judged = [
        result.score
        for found in of_move.values()
        for strategy in (FLAT, FASTEST, SWING, TIME)
        for result in found.get(strategy, {}).values()
        if result.score or result.why != UNOBSERVED
    ]
    if not judged:
        return []
    worst = max(math.inf if s is None else s.later * s.length for s in judged)
    return [
        harness.Claim(
            "On frequency converters an LQR about the planned path of the load leaves it within "
            f"{1e3 * CLOSE:g} mm of plumb 20 s after the arrival, in every move and case "
            f"({1e3 * worst:.0f} mm at most).",
            worst < CLOSE,
        )
    ]


def _in_time(setup: harness.Setup, moves: Iterable[Results]) -> list[harness.Claim]:
    """Whether each MPC is done within its period, in every period of every run."""
    made = list(moves)
    return [claim for strategy in PREDICTIVE for claim in _one_in_time(setup, made, strategy)]


def _one_in_time(
    setup: harness.Setup, moves: Iterable[Results], strategy: str
) -> list[harness.Claim]:
    runs = [
        result.calls
        for found in moves
        for result in found.get(strategy, {}).values()
        if len(result.calls)
    ]
    if not runs:
        return []
    name = "The MPC" if strategy == MPC else f"{strategy[0].upper()}{strategy[1:]}"
    calls, period = np.concatenate(runs), mpc_period(setup)
    solves = np.concatenate([run[:: round(period / setup.control_period)] for run in runs])
    return [
        harness.Claim(
            f"{name} is done within its period of {1e3 * period:g} ms: it takes "
            f"{1e3 * calls.max():.2g} ms of processor time at most, "
            f"{1e3 * np.median(solves):.2g} ms in the median, in {len(solves):,} periods on this "
            "machine, garbage of Python's aside.",
            bool(calls.max() < period),
        )
    ]


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    made = harness.parser(
        "compare",
        "every strategy for a move, on the same moves and limits, as planned and when things are "
        "not as planned.",
    )
    harness.add_setup(made, "damp_swing")
    made.add_argument(
        "--drive",
        choices=(IDEAL, "velocity"),
        default=IDEAL,
        help="ideal: drives take what each strategy answers, efforts or accelerations; velocity: "
        "all drives have typical frequency converters, which take rates",
    )
    made.add_argument(
        "--only",
        nargs="+",
        choices=STRATEGIES,
        metavar="STRATEGY",
        help=f"only these strategies, of: {', '.join(STRATEGIES)}",
    )
    made.add_argument(
        "--jobs",
        type=int,
        default=None,
        metavar="N",
        help="processes, by default one for each processor",
    )
    return harness.conduct(made, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
