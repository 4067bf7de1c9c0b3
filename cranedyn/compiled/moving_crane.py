"""A crane that compiled code moves on by one control period at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cranedyn.compiled.binding import BoundKernel
from cranedyn.compiled.kernel import Kernel, KernelOptions
from cranedyn.compiled.loop_tables import command_tables, single_table
from cranedyn.compiled.memory_layout import BufferLayout, size, slices
from cranedyn.compiled.step import check_rule
from cranedyn.compiled.verify import crane_kernel
from cranedyn.dynamics.contact import anchors_at
from cranedyn.dynamics.root_motion import ROOT_NUMBERS, SAMPLES_PER_STEP
from cranedyn.interfaces import State
from cranedyn.simulation.base_samples import BaseSamples
from cranedyn.simulation.log import Actuation
from cranedyn.simulation.run_spec import RunSpec

if TYPE_CHECKING:
    from cranedyn.compiled.horizon.memory import Programme

# Looked up once, for `CompiledCrane.read_state`: a control period takes microseconds.
_read_only_array = np.frombuffer
_new_tuple = tuple.__new__


class CompiledCrane:
    """A crane in the memory of compiled code, which also computes what acts at control instants.

    Attributes:
        spec: The run.
        sizes: Layout of the memory.
        memory: The state of the crane, see `BufferLayout.state`.
        places: Slices of the sections of the memory.
        force: External forces before and from the last control instant on [N], shape (2, 3
            points).
        state: State of the crane.
        instant: Control instants that have passed since the start.
        base: What the crane feels of a base that moves; None for a base at rest.
        acting: Row of the log of the last control instant, but for the setpoint, see
            `cranedyn.compiled.memory_layout.row_sections`. It changes with the next step.
    """

    acting: np.ndarray

    def __init__(self, spec: RunSpec) -> None:
        """Begin at the start of a run, without command.

        Raises:
            OutOfRange: If there is no code for the stepping rule.
        """
        check_rule(spec.integrator)
        self.spec = spec
        delay_steps = None if spec.converters is None else spec.command_delay
        sizes = BufferLayout.of(spec.crane.layout, delay_steps, spec.contacts)
        self.sizes = replace(sizes, ledger=True)
        self.places = slices(self.sizes.state)
        self.memory = np.zeros(size(self.sizes.state))
        # Two rows: the code computes the efforts until an instant by the forces of the row before.
        self.force = np.zeros((2, size(self.sizes.force)))
        # Numbers of the crane that the code reads from memory; known with the code.
        self._varied_numbers = np.zeros(0)
        # Code bound to the memory: for a control period, and for its first instant alone.
        self._calls: tuple[Callable[[], None], Callable[[], None]] | None = None
        self.base: BaseSamples | None = None
        self._root: np.ndarray | None = None
        if spec.base is not None:
            self.base = BaseSamples(spec)
            # The code runs the second of two instants, see `prepare`; no number of the period
            # before is read.
            self._root = np.zeros((2 * SAMPLES_PER_STEP * spec.clocks.steps + 1, ROOT_NUMBERS))
        self._create_views()
        self.reset(spec.start)

    def __getstate__(self) -> dict[str, Any]:
        """Return all but what is bound to the memory, for a copy with its own memory."""
        return vars(self) | {"_calls": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copy and its views of the memory."""
        vars(self).update(state)
        self._create_views()

    def _create_views(self) -> None:
        """Create the views of the memory."""
        self._position = self.memory[self.places["q"]]
        self._rate = self.memory[self.places["v"]]

    def reset(self, start: State) -> None:
        """Return to a state, without command, force or work; compiled code is kept."""
        spec = self.spec
        self.state = start
        self.instant = 0
        self._force_in_world: np.ndarray | None = None
        self.memory[:] = 0.0
        self.force[:] = 0.0
        self._position[:] = start.q
        self._rate[:] = start.v
        if spec.contacts is not None:
            anchors = anchors_at(spec.crane, spec.contacts, start)
            self.memory[self.places["anchors"]] = anchors.T.ravel()
        if spec.converters is not None:
            driven_rates = start.v[spec.crane.layout.drives]
            self.memory[self.places["reference"]] = driven_rates
            # The converters have been commanded the rates of the start for as long as they delay.
            delayed = self.memory[self.places["delayed_commands"]].reshape(-1, self.sizes.m)
            delayed[:] = driven_rates

    def step(self, command: np.ndarray, force: np.ndarray | None) -> State:
        """Hold a command and external forces for a control period, and return the state at its end,
        see `cranedyn.simulation.engine.MovingCrane`.
        """
        period, _ = self.prepare()
        self._set(command, force)
        if self.base is not None and self._root is not None:
            first_row = SAMPLES_PER_STEP * self.spec.clocks.steps
            self._root[first_row:] = self.base.of_period(self.instant)
        period()
        self.instant += 1
        return self.read_state()

    def hold(self, command: np.ndarray, force: np.ndarray | None) -> None:
        """Hold a command and external forces, and compute what acts, without moving on."""
        _, instant = self.prepare()
        self._set(command, force)
        if self.base is not None and self._root is not None:
            first_row = SAMPLES_PER_STEP * self.spec.clocks.steps
            self._root[first_row] = self.base.of_instant(self.instant)
        instant()

    def _set(self, command: np.ndarray, force: np.ndarray | None) -> None:
        """Write a command and external forces into the memory that the code reads."""
        self._command[...] = command
        if self.spec.has_forces:
            self._force_in_world = np.zeros(self.sizes.points * 3) if force is None else force
            self.force[0] = self.force[1]
            if force is not None and self.base is not None:
                # The code computes in the axes of the base, in which it holds the force.
                force = force @ self.base.rotation(self.instant)
            self.force[1] = 0.0 if force is None else force.ravel()

    @property
    def actuation(self) -> Actuation:
        """What acts on the crane from the last control instant on, to be read after the first step;
        its arrays change with the next one.
        """
        rows = self._acting_sections
        return Actuation(
            rows["needed"],
            rows["effort"],
            rows["effort_before"],
            self._force_in_world,
            contact_work=float(rows["contact_work"][0]),
            impact_work=float(rows["impact_work"][0]),
            cable_buffer_force=float(rows["cable_buffer_force"][0]),
            saturated=bool(rows["saturated"][0]),
        )

    def prepare(self) -> tuple[Callable[[], None], Callable[[], None]]:
        """Return two functions that call the code: for a whole control period, and for its first
        instant alone. The code is compiled and bound to the memory when they are first asked for.
        """
        if self._calls is None:
            rows = np.zeros((2, size(self.sizes.row)))
            tables = (*command_tables(self.sizes), self.force)
            self._command = tables[0][0, slices(self.sizes.gain_table)["feed_forward"]]
            sections = slices(self.sizes.row)
            self.acting = rows[1, self.sizes.m :]
            self._acting_sections = {name: rows[1, place] for name, place in sections.items()}
            # The row of the instant before is the first of the two.
            loop = self.loop(self.code(), tables, rows, first=1, end=2, root=self._root)
            self._calls = loop.bind_calls()
        return self._calls

    def code(
        self,
        programme: Programme | None = None,
        areas: tuple = (),
        *,
        integral: bool = False,
        controller_states: int = 0,
    ) -> Kernel:
        """Return the code, compiled and verified at the first use.

        Args:
            programme: Predictive controller that the code computes; None for none.
            areas: Drag areas of the points [m²] where the code computes the wind; empty where it is
                given forces.
            integral: Whether the controller has integrals.
            controller_states: Number of states of the controller.
        """
        spec = self.spec
        options = KernelOptions(
            lanes=1,
            drive=spec.drive,
            integrator=spec.integrator,
            buffers=spec.has_buffers,
            integral=integral,
            forces=spec.has_forces,
            log=True,
            delay_steps=self.sizes.delay_steps,
            programme=programme,
            contacts=spec.contacts,
            ledger=True,
            areas=areas,
            controller_states=controller_states,
            base=spec.base is not None,
        )
        code, self._varied_numbers = crane_kernel(spec.crane, options, spec.converters)
        return code

    def loop(
        self,
        code: Kernel,
        tables: tuple[np.ndarray, ...],
        rows: np.ndarray,
        *,
        end: int,
        first: int = 0,
        horizon: np.ndarray | None = None,
        memory: np.ndarray | None = None,
        root: np.ndarray | None = None,
    ) -> BoundKernel:
        """Return code bound to the memory of this crane.

        Args:
            code: The code.
            tables: Tables of gains, setpoints and forces, with a row for each control instant.
            rows: Rows of the log that it writes, shape (instants, columns).
            end: Instant that no steps follow.
            first: First control instant.
            horizon: Memory of a predictive controller that the code computes; None for none.
            memory: Memory of the crane and of the states of its controller behind it; None for that
                of this crane alone, under a controller without states.
            root: Motion of the base, see `BoundKernel`; None for a base at rest.
        """
        if memory is None:
            memory = self.memory
        # Code computes groups of lanes: here one group of one crane.
        return BoundKernel(
            code,
            self.spec.clocks,
            [single_table(table) for table in tables],
            first=first,
            last=len(rows),
            end=end,
            state=memory.reshape(1, -1, 1),
            numbers=self._varied_numbers.reshape(1, -1, 1),
            log=rows.reshape(1, -1, 1),
            horizon=horizon,
            root=None if root is None else single_table(root),
        )

    def read_state(self) -> State:
        """Read the state from the memory and return it."""
        # The same as State(q, v) of read-only copies, in half the time.
        arrays = _read_only_array(self._position.tobytes()), _read_only_array(self._rate.tobytes())
        self.state = state = _new_tuple(State, arrays)
        return state
