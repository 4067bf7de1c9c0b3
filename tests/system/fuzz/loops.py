"""Loops that are not ours: whatever is asked of a fleet, a stepper or an environment of Gymnasium,
in any order, and what becomes of it where one asks nothing odd.

What steps is made twice. The first is asked everything; the second only what the first took. If
they are not the same to the bit at the end, a call was refused and changed something, or a copy was
none.
"""

from __future__ import annotations

import copy
import os
import pickle
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from cranedyn.bridges.gymnasium import TowerCraneEnv, TowerCraneVectorEnv
from cranedyn.compiled.batch import simulate_batch
from cranedyn.compiled.fleet import Fleet
from cranedyn.compiled.horizon.receding import Receding, receding
from cranedyn.dynamics.integrators import rk4, semi_implicit_euler
from cranedyn.errors import CraneError, RunError
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references.limits import Limits
from cranedyn.simulation.stepper import Stepper
from experiments.relatives.catalogue import OVERHEAD
from tests.system.fuzz.core import Broken, Case, Generator, interrupt_after

Words = tuple[list[str], list[str]]
"""Expressions that are right for an argument, and such as are odd."""


def some(seed: int, *shape: int) -> np.ndarray:
    """Numbers from -1 to 1, the same for the same seed."""
    return np.random.default_rng(seed).uniform(-1.0, 1.0, shape)


_NUMBERS = [
    "np.nan",
    "0",
    "-1",
    "-0.0",
    "1e300",
    "5e-324",
    "np.inf",
    "2.5",
    "np.float32(0.1)",
    "2**63",
]
_ARRAYS = [
    *(
        "np.zeros(0)",
        "np.full((m, n), np.nan)",
        "np.full((m, n), np.inf)",
        "np.full((m, n), 1e300)",
    ),
    *("some(1, n, m)", "some(1, m, n + 1)", "some(1, m, n).astype('f2')", "some(1, m)", "0.0"),
    *("np.zeros((m, n), dtype=complex)", "np.full(m, np.nan)", "np.ma.masked_all(m)"),
    *("some(1, m, n).astype('>f8')", "some(1, m, n)[::-1, ::-1]", "some(1, m, n).tolist()"),
    *("np.full(m, -np.inf)", "np.full(m, 1e300)", "[0.0] * m", "np.full((n, m), np.nan)"),
    *("np.zeros(0)", "np.zeros((1,) * 32)", "np.full((n, m), 1.0000001)"),
]
_STARTS: Words = (
    ["start", "crane.state(phi=0.2, x=12.0)", "State(some(3, 5) * 0.1 + start.q, some(4, 5))"],
    [
        *("State(start.q, np.full(5, np.nan))", "State(start.q[:4], start.v[:4])", "[start]"),
        *("(start.q, start.v)", "State(start.q * 1e300, start.v)", "[start] * n"),
        *("State(np.zeros((0, 5)), np.zeros((0, 5)))", "State(start.q, np.full(5, np.inf))"),
        *("State(np.tile(start.q, (n, 1)), np.zeros((n, 5)))", "State(-start.q, start.v)"),
        "State(start.q, np.full(5, 1e200))",
    ],
)
_WHICH: Words = (
    ["np.arange(n)", "np.array([0])", "np.array([n - 1])"],
    [
        *("np.array([n])", "np.array([-1])", "np.array([0.5])", "np.zeros(0, dtype=int)", "[0]"),
        *("np.array([0, 0])", "np.array([2**63], dtype=np.uint64)", "np.zeros((1, 1))"),
        *("np.array([1e300])", "np.array([np.nan])", "np.ones(n, dtype=bool)"),
    ],
)
_COMMANDS: Words = (
    ["some(1, m, n)", "some(2, m, n) * 0.3", "np.zeros((m, n))", "some(5, m, n) * 1e4"],
    _ARRAYS,
)
_COMMAND: Words = (["some(1, m)", "np.zeros(m)", "[0.1, 0.2, -0.1]", "some(2, m) * 1e4"], _ARRAYS)
_ACTIONS: Words = (["some(1, n, m)", "some(2, n, m)", "np.ones((n, m))"], _ARRAYS)
_ACTION: Words = (["some(1, m)", "some(2, m)", "-np.ones(m)"], _ARRAYS)
_SEEDS: Words = (["None", "0", "3", "np.int64(7)"], [*_NUMBERS, "[1, 2]", "2**200", "-(2**70)"])
_OPTIONS: Words = (
    ["None", "{}", "{'goal': (0.3, 12.0, 10.0)}", "{'start': start}"],
    [
        *("{'begin': 0}", "{'goal': (0.0, np.nan, 10.0)}", "{'goal': [1.0] * 4}"),
        *("{'start': State(np.zeros(4), np.zeros(4))}", "{'goal': (0.0, 500.0, 10.0)}"),
        *("{'reset_mask': np.zeros(n, dtype=bool)}", "{'reset_mask': [1]}"),
        *("{'reset_mask': np.arange(n) == 0}", "{'goal': np.full((3, n), 9.0)}"),
        *("{'start': State(start.q + np.nan, start.v)}", "{'start': State(start.q * 9, start.v)}"),
    ],
)
_FLAGS: Words = (["False", "True"], [])

_MADE: dict[str, dict[str, Words]] = {
    "Fleet": {
        "cranes": (["crane", "[crane, heavy]"], ["[crane, overhead]", "overhead", "[heavy]", "[]"]),
        "count": (["1", "2", "9", "n"], [*_NUMBERS, "600", "10**9", "10**15"]),
        "dt": (["5e-4", "1e-3"], [*_NUMBERS, "1e-9", "0.1"]),
        "control_period": (["0.1", "5e-3"], [*_NUMBERS, "0.1003", "1e9", "1e-9"]),
        "drive": (["'motion'", "'effort'"], ["'velocity'", "''"]),
        "forces": _FLAGS,
        "threads": (["1"], [*_NUMBERS, "2", "1025"]),
    },
    "Stepper": {
        "crane": (["crane", "heavy"], ["overhead"]),
        "start": _STARTS,
        "dt": (["5e-4", "1e-3"], [*_NUMBERS, "1e-9", "0.1"]),
        "control_period": (["5e-3", "0.1"], [*_NUMBERS, "5.1e-3", "1e9", "1e-9"]),
        "drive": (["'effort'", "'motion'", "'velocity'"], ["''"]),
        "forces": _FLAGS,
        "buffers": (["False"], ["True"]),
        "integrator": (["semi_implicit_euler"], ["rk4"]),
        "engine": (["'pinocchio'", "'compiled'"], ["''"]),
    },
    "TowerCraneEnv": {
        "crane": (["crane", "[crane, heavy]"], ["overhead", "[crane, overhead]"]),
        "control_period": (["0.1"], [*_NUMBERS, "0.1003", "1e9"]),
        "dt": (["5e-4"], [*_NUMBERS, "0.1"]),
        "render_mode": (["None"], ["'rrd'", "'human'"]),
        "folder": (["'episodes'"], ["'/proc/x'", "'a\\0b'", "'file'", "'\\udcff'"]),
        "wind": (["0.0", "12.0"], [*_NUMBERS, "1e5"]),
        "swing": (["0.1"], _NUMBERS),
        "swing_limit": (["0.5"], [*_NUMBERS, "0.01"]),
        "reach": (["(0.6, 10.0, 5.0)"], ["(0.0, 0.0, 0.0)", "(np.nan,) * 3", "(1e300,) * 3", "()"]),
        "action": (["'velocity'", "'acceleration'"], ["'effort'"]),
        "payload_area": (["4.0"], [*_NUMBERS, "1e9"]),
        "limits": (
            ["Limits((0.08, 1.5, 1.0), (0.02, 0.4, 0.4))"],
            ["Limits((1.0, 1.0), (1.0, 1.0))", "Limits((1e9,) * 3, (1e9,) * 3)"],
        ),
    },
}
_MADE["TowerCraneVectorEnv"] = {
    **{
        name: words
        for name, words in _MADE["TowerCraneEnv"].items()
        if name not in ("render_mode", "folder")
    },
    "num_envs": (["1", "3", "n"], [*_NUMBERS, "10**9", "10**15"]),
    "max_episode_steps": (["2", "400"], _NUMBERS),
    "autoreset_mode": (["'NextStep'", "'SameStep'", "'Disabled'"], ["'next'"]),
    "render_mode": (["None"], ["'rrd'"]),
    "threads": (["1"], [*_NUMBERS, "2"]),
}

_ASKED: dict[str, dict[str, tuple[Words, ...]]] = {
    "Fleet": {
        "step": (_COMMANDS,),
        "place": (_WHICH, _STARTS, (["None"], ["np.zeros(n)", "np.array([1])", "[9]"])),
        "push": (_WHICH, (["some(1, n, 6) * 300", "np.zeros((n, 6))"], [*_ARRAYS, "some(1, 6)"])),
        "advance": ((["0"], [*_NUMBERS, "1", "9"]), _COMMANDS),
    },
    "Stepper": {
        "step": (
            _COMMAND,
            (["None", "some(1, 2, 3)"], [*_ARRAYS, "some(1, 6)", "np.full((2, 3), np.nan)"]),
        ),
        "reset": (_STARTS,),
    },
    "TowerCraneEnv": {
        "step": (_ACTION,),
        "reset": (_SEEDS, _OPTIONS),
        "render": (),
        "close": (),
    },
    "TowerCraneVectorEnv": {
        "step": (_ACTIONS,),
        "reset": (_SEEDS, _OPTIONS),
        "close": (),
    },
}
_SHAPES = {"Fleet": "m, n", "Stepper": "m", "TowerCraneEnv": "m", "TowerCraneVectorEnv": "n, m"}
"""Of a command."""

_BY_NAME = {"reset": ("seed", "options")}
_COPIES: dict[str, Callable[[Any], Any]] = {
    "deepcopy": copy.deepcopy,
    "pickle": lambda one: pickle.loads(pickle.dumps(one)),
}


@cache
def _names() -> dict[str, Any]:
    crane = load_crane()
    return {
        **{made.__name__: made for made in (Fleet, Stepper, TowerCraneEnv, TowerCraneVectorEnv)},
        **{"np": np, "State": State, "Limits": Limits, "some": some, "m": 3, "n": 3},
        **{"semi_implicit_euler": semi_implicit_euler, "rk4": rk4},
        **{"crane": crane, "start": crane.start, "heavy": load_crane(payload_mass=3000.0)},
        "overhead": load_crane(OVERHEAD),
        "given": lambda *given, **named: [*given, *named.values()],
    }


@dataclass(frozen=True)
class Sequences:
    """Calls of what steps, in any order: good ones, odd ones, and copies from which one goes on."""

    made: str
    weight: float = 1.0
    interruptible: bool = True

    @property
    def name(self) -> str:
        """Of the kind."""
        return f"loop {self.made}"

    def draw(self, rng: Random) -> Case:
        """How it is made, and what is asked of it."""
        share = rng.choice([0.0, 0.0, 0.0, 0.1])
        arguments = [
            f"{name}={_word(rng, words, share)}"
            for name, words in _MADE[self.made].items()
            if name in ("cranes", "count", "crane") or rng.random() < 0.4
        ]
        if many := {"Fleet": "count", "TowerCraneVectorEnv": "num_envs"}.get(self.made):
            if share == 0.0:  # as many as commands are given
                arguments = [one for one in arguments if one.partition("=")[0] != many]
                arguments.append(f"{many}=n")
        asked = _ASKED[self.made]
        odd = rng.choice([0.05, 0.3])
        parts = [f"reset(seed={rng.randrange(9)})"] * (self.made.startswith("T"))
        for _ in range(rng.choice([1, 3, 6, 10])):
            name = rng.choice([*asked, "step", "step", "copy"])
            if name == "copy":
                parts.append(rng.choice(list(_COPIES)))
                continue
            words = [_word(rng, one, odd) for one in asked[name]]
            if self.made.startswith("T") and name in _BY_NAME:
                words = [f"{key}={one}" for key, one in zip(_BY_NAME[name], words, strict=True)]
            parts.append(f"{name}({', '.join(words)})")
        return Case(f"{self.made}({', '.join(arguments)})", parts)

    def attempt(self, case: Case, folder: Path) -> str:
        """Ask the one everything, and the other what the first took."""
        os.chdir(folder)
        Path("file").write_text("")
        names = _names()
        try:
            one, two = eval(case.head, dict(names)), eval(case.head, dict(names))
        except CraneError as error:
            _sentence(error)
            return "refused"
        refused = 0
        for text in case.parts:
            if text in _COPIES:
                one, before = _COPIES[text](one), one
                with suppress(CraneError):  # what the original does is nothing to the copy
                    _ask(before, f"step(some(8, {_SHAPES[self.made]}))")
                continue
            seen = _seen(one)
            try:
                _ask(one, text)
            except CraneError as error:
                _sentence(error)
                refused += 1
                if isinstance(error, RunError) and not _same(seen, _seen(one)):
                    with suppress(RunError):  # it went where no crane goes, and so does the other
                        _ask(two, text)
                elif not _same(seen, _seen(one)):
                    raise Broken(f"a call that is refused changes a {self.made}", text) from None
                continue
            given = eval("given" + text[text.index("(") :], dict(names))
            if not _finite(given):
                raise Broken(f"a {self.made} took what is not finite", text)
            _ask(two, text)
        ends = [(_seen(one), _seen(two))]
        if self.made.startswith("T"):  # draws what follows from the same numbers
            one.reset(), two.reset()
            ends.append((_seen(one), _seen(two)))
        if not all(_same(*pair) for pair in ends):
            raise Broken(
                f"a {self.made} that refused calls or was copied goes elsewhere than one that did "
                "not",
                ends,
            )
        return "some refused" if refused else "good"

    def shown(self, case: Case) -> str:
        """The calls."""
        return "\n    ".join([case.head, *case.parts])


def _word(rng: Random, words: Words, odd: float) -> str:
    return rng.choice(words[1] if rng.random() < odd and words[1] else words[0])


def _ask(one: Any, text: str) -> None:
    eval(f"one.{text}", _names() | {"one": one})


def _sentence(error: CraneError) -> None:
    if not (str(error).isprintable() and str(error).endswith(".")):
        raise Broken("an error that is no printable sentence", repr(str(error))) from None


def _seen(one: Any) -> list[np.ndarray]:
    """What can be seen of it."""
    if isinstance(one, Fleet):
        return [one.z.copy()]
    if isinstance(one, Stepper):
        return [np.array(one.state), np.array([one.t])]
    return [one.task.fleet.z.copy(), one.task.goal.copy(), one.task.goal_distance.copy()]


def _same(some: Sequence[np.ndarray], others: Sequence[np.ndarray]) -> bool:
    return all(np.array_equal(a, b, equal_nan=True) for a, b in zip(some, others, strict=True))


def _finite(given: Any) -> bool:
    """Whether no number among what was given is unknown or without bound."""
    if isinstance(given, dict):
        return _finite(list(given.values()))
    if isinstance(given, list | tuple):
        return all(map(_finite, given))
    if not isinstance(given, np.ndarray | np.number | float):
        return True
    values = np.asarray(given)
    return values.dtype.kind not in "fc" or bool(np.isfinite(values).all())


# --- predictive control in lanes ------------------------------------------------------------------

_GLITCHES = (0.0, 0.1, -30.0, 200.0, 1257.0, -1257.0, 1e8, -1e300)


@cache
def _predictive(kind: int, drive: str) -> tuple[Crane, Receding]:
    """A crane of random numbers, and a controller of random ones; the usual ones as kind 0.

    Raises:
        CraneError: If no crane has these numbers, or no controller is made for it.
    """
    rng = np.random.default_rng(kind)
    if kind == 0:
        crane, limits, more = load_crane(), Limits((0.1, 1.0, 1.0), (0.05, 0.5, 0.5)), {}
    else:
        values = {
            "payload_mass": 10.0 ** rng.uniform(1.0, 4.5),
            "trolley_mass": 10.0 ** rng.uniform(1.5, 3.5),
            "slewing_inertia": 10.0 ** rng.uniform(4.0, 7.5),
            "damp_swing": rng.choice([0.0, 10.0 ** rng.uniform(-2.0, 4.0)]),
            "hoist_effort": 10.0 ** rng.uniform(3.5, 6.0),
            "trolley_effort": 10.0 ** rng.uniform(2.0, 5.0),
        }
        crane = load_crane(gravity=float(rng.choice([9.80665, rng.uniform(1.0, 25.0)])), **values)
        rates, accelerations = 10.0 ** rng.uniform(-2.0, 1.0, (2, 3))
        limits = Limits(tuple(rates), tuple(accelerations))
        more = {
            "stages": int(rng.integers(2, 50)),
            "stage": float(rng.choice([0.1, 0.2, 0.4])),
            "swing_limit": float(rng.uniform(0.01, 1.0)),
            "settling": float(10.0 ** rng.uniform(-2.0, 2.0)),
            "smoothing": float(10.0 ** rng.uniform(-3.0, 1.0)),
        }
    return crane, receding(crane, limits, drive=drive, **more)


@dataclass(frozen=True)
class Lanes:
    """Cranes under predictive control that begin anywhere, some with a reading that is off, in a
    batch: each goes where it goes alone, in any order of the batch, to the bit.
    """

    name: str = "loop receding"
    weight: float = 0.3
    interruptible: bool = True

    def draw(self, rng: Random) -> Case:
        """Which crane and drive, and where each begins and what it reads wrongly."""
        kind = rng.randrange(1, 25) if rng.random() < 0.4 else 0
        drive = ("effort", "velocity", "motion")[kind % 3]
        hard = rng.choice([0.05, 0.3, 1.0])
        parts = [
            (
                [round(hard * rng.uniform(-1.0, 1.0), 3) for _ in range(10)],
                rng.random() < 0.3,
                (rng.randrange(40), rng.randrange(10), rng.choice(_GLITCHES)),
            )
            for _ in range(rng.choice([2, 3, 7, 8, 9, 12]))
        ]
        return Case((kind, drive, rng.randrange(1000)), parts)

    def attempt(self, case: Case, folder: Path) -> str:
        """Run the batch in two orders, and one of it alone and by hand."""
        kind, drive, seed = case.head
        if not case.parts:
            return "nothing"
        interrupt_after(6.0)  # to compile takes a few seconds of the first case of a kind
        rng = np.random.default_rng(seed)
        try:
            crane, law = _predictive(kind, drive)
            starts, goal, offset = self._given(case, crane, rng)
            ends = _run(crane, law, goal, starts, offset, drive)
            order = rng.permutation(len(starts))
            turned = _run(crane, law, goal, starts[order], offset[order], drive)
            i = int(rng.integers(len(starts)))
            alone = _run(crane, law, goal, starts[[i]], offset[[i]], drive)
        except CraneError as error:
            _sentence(error)
            return "refused"
        if not np.isfinite(ends[0]).all():
            raise Broken("a crane under predictive control ends nowhere", ends)
        if not _same(turned, [part[order] for part in ends]):
            raise Broken("a crane goes elsewhere in another lane", (ends, turned, order))
        if not _same(alone, [part[[i]] for part in ends]):
            raise Broken("a crane goes elsewhere alone than in a batch", (i, ends, alone))
        self._by_hand(crane, law, starts[i], offset[i], goal)
        return "some failed" if ends[1].any() else "good"

    def shown(self, case: Case) -> str:
        """What was drawn."""
        return f"{self.name}: {case}"

    def _given(
        self, case: Case, crane: Crane, rng: np.random.Generator
    ) -> tuple[np.ndarray, Setpoint, np.ndarray]:
        """Where each begins, shape (cranes, 10), where they go, and what their readings are off."""
        low, high = crane.lower, crane.upper
        middle, half = (low + high) / 2.0, (high - low) / 2.0
        half[crane.swings] = np.minimum(half[crane.swings], 0.6)
        middle[0], half[0] = 0.0, min(half[0], 3.0)
        spread = np.concatenate([half * 0.99, [0.08, 1.5, 0.5, 0.5, 1.0]])
        centre = np.concatenate([middle, np.zeros(5)])
        starts = centre + spread * np.array([start for start, *_ in case.parts])
        offset = np.zeros((len(starts), 60, 10))
        for lane, (_, wrong, (row, column, value)) in enumerate(case.parts):
            offset[lane, row, column] = value if wrong else 0.0
        ends = (centre + 0.9 * spread * rng.uniform(-1.0, 1.0, 10))[crane.layout.drives]
        return starts, Setpoint(ends, np.zeros(3), np.zeros(3)), offset

    def _by_hand(
        self, crane: Crane, law: Receding, start: np.ndarray, offset: np.ndarray, goal: Setpoint
    ) -> None:
        """Ask the controller itself; whatever it reads, it commands what the drives can."""
        one = copy.deepcopy(law)
        for k, off in enumerate(offset[:44]):
            read = start + off
            command = one(k * 5e-3, State(read[:5], read[5:]), goal)
            if not np.isfinite(command).all():
                raise Broken("a predictive controller commands what is not finite", (k, command))


def _run(
    crane: Crane,
    law: Receding,
    goal: Setpoint,
    starts: np.ndarray,
    offset: np.ndarray,
    drive: Any,
) -> list[np.ndarray]:
    """Where each ends, how often its optimisation failed, and until when the model held."""
    run = simulate_batch(
        crane,
        law,
        lambda t: goal,
        start=State(starts[:, :5], starts[:, 5:]),
        duration=0.3,
        drive=drive,
        sensor_offset=offset,
        threads=1,
    )
    return [np.hstack(run.end), np.asarray(run.failures), np.asarray(run.valid_until)]


GENERATORS: list[Generator] = [*map(Sequences, _MADE), Lanes()]
