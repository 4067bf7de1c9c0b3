"""A controller of one's own from a file, for comparisons and exporters.

`open_controller` takes one of these:

* ``FILE.py:FUNCTION``. The file is run. ``FUNCTION(crane, motion)`` returns a controller that
  commands efforts, or a pair of a controller and what its commands are, such as
  ``return controller, "velocity"``. It gets the crane that is planned for, and the motion that the
  crane is to make: a `Motion` of one row, the rest at the start, where there is none. It is called
  anew for each run, so that controllers may remember.
* ``FILE.json`` or ``FILE.mat``: matrices of a gain or of a discrete state-space system, see
  `read_state_space`. Nothing is run.
"""

from __future__ import annotations

import importlib.util
import inspect
import io
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, cast, get_args

import numpy as np

from cranedyn.checks import as_array, finite, number, short_repr
from cranedyn.controllers.affine import at_rest_shifted
from cranedyn.controllers.linear import (
    AntiWindup,
    LinearController,
    SetpointSource,
    linear_controller,
)
from cranedyn.data.files import open_file, parse_json, read_bytes, read_text
from cranedyn.dynamics.linearisation import held_states
from cranedyn.errors import CraneError, DataError, OutOfRange, UnknownName, format_error, quoted
from cranedyn.interfaces import Controller, Drive, State
from cranedyn.model.crane import Crane
from cranedyn.model.signals import input_names, state_names
from cranedyn.references.motion import Motion

FORMS = "FILE.py:FUNCTION, FILE.json or FILE.mat"
"""Forms in which a controller of one's own is named."""

_JSON_KEYS = ("A", "B", "C", "D", "dt", "inputs", "outputs")
"""What a file in JSON may hold."""

_NAMES_IN_MATLAB = {"inputs": "InputName", "outputs": "OutputName"}
"""Names of the signals in a file of MATLAB that holds the fields of an `ss` object."""

_REFUSED_IN_MATLAB = ("InputDelay", "OutputDelay", "InternalDelay")
"""Fields of an `ss` object that change what it computes and are not read: refused unless zero."""

_SETPOINT = "_set"
"""End of the name of an input that is the position of the setpoint of a drive, such as "x_set"."""

_WRITTEN_IN_MATLAB = ("z0", "u0", "x0", "anti_windup", "u_limits")
"""Variables that `controller_to_matlab` writes beside the matrices, see `WrittenRest`."""


class DrivenController(NamedTuple):
    """A controller with the kind of its commands.

    Attributes:
        controller: The controller.
        drive: "effort", "motion" for accelerations, or "velocity" for rates.
    """

    controller: Controller
    drive: Drive


class ControllerFile(ABC):
    """A controller of one's own, which is made anew for each run.

    Attributes:
        name: Its name in tables: that of the function, or of the file without its ending.
        source: How it was named.
    """

    name: str
    source: str

    @abstractmethod
    def make(self, crane: Crane, motion: Motion, dt: float = 5e-4) -> DrivenController:
        """Return the controller, a new one for each run.

        Args:
            crane: The crane that is planned for.
            motion: The motion that it is to make, of one row for a rest.
            dt: Physics step of the run [s]; the period of a motion is a multiple of it.

        Raises:
            CraneError: If it cannot be made.
        """


def is_controller_file(source: str) -> bool:
    """Return whether a text is meant as a controller of one's own, and not as one of cranedyn. So
    is a file in Python without a function, which `open_controller` refuses.
    """
    file, _, _ = source.rpartition(":")
    return file.endswith(".py") or source.endswith((".py", ".json", ".mat"))


def open_controller(source: str) -> ControllerFile:
    """Return the controller that a text names, see `FORMS`; a file in Python is run.

    Raises:
        DataError: If the file cannot be read or run, or the text has none of these forms.
        UnknownName: If the file has no such function.
    """
    file, _, function = source.rpartition(":")
    if file.endswith(".py"):
        return _FunctionFile(source, Path(file), function)
    if source.endswith((".json", ".mat")):
        return _StateSpaceFile(source)
    raise DataError(f"{quoted(source)} names no controller; allowed is {FORMS}.")


# --- functions ------------------------------------------------------------------------------------


class _FunctionFile(ControllerFile):
    """A function in a file of Python that makes the controller."""

    def __init__(self, source: str, file: Path, function: str) -> None:
        self.name = function
        self.source = source
        self._function = load_function(file, function, ("crane", "motion"))

    def make(self, crane: Crane, motion: Motion, dt: float = 5e-4) -> DrivenController:
        try:
            made = self._function(crane, motion)
        except CraneError:
            raise
        except Exception as error:
            raise CraneError(f"{self.source} failed: {format_error(error)}") from error
        controller = made
        drive: Any = "effort"
        if isinstance(made, tuple) and len(made) == 2:
            controller, drive = made
        kinds = ", ".join(get_args(Drive))
        if not callable(controller):
            allowed = f"a controller, or a pair of a controller and one of {kinds}"
            raise OutOfRange(f"result of {self.source}", type(made).__name__, allowed)
        if drive not in get_args(Drive):
            raise OutOfRange(f"commands of {self.source}", short_repr(drive), f"one of {kinds}")
        return DrivenController(cast(Controller, controller), drive)


def load_function(file: Path, name: str, arguments: Sequence[str]) -> Callable[..., Any]:
    """Run a file of Python and return a function of it.

    The folder of the file stays on the path for modules, after what is installed. Of two folders
    with helper modules of one name the first one counts.

    Args:
        file: The file.
        name: Name of the function.
        arguments: Names of the arguments with which it will be called.

    Raises:
        DataError: If the file cannot be read or run, or the function takes other arguments.
        UnknownName: If there is no such function.
    """
    open_file(file).close()  # its error says what is wrong with the file
    # Two files of one name in different folders are two modules.
    module_name = f"cranedyn_controller_of_{file.resolve()}"
    spec = importlib.util.spec_from_file_location(module_name, file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look for their module among those that are imported.
    sys.modules[module_name] = module
    # Modules beside the file can be imported, as if it were a program; those that are installed go
    # first.
    folder = str(file.resolve().parent)
    if folder not in sys.path:
        sys.path.append(folder)
    try:
        spec.loader.exec_module(module)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # other people's code, which may also call sys.exit
        del sys.modules[module_name]
        reason = f"{type(error).__name__}: {error}"
        raise DataError(f"{file} cannot be run: {reason}.") from error

    function = getattr(module, name, None)
    if not callable(function):
        defined = []
        for key, value in vars(module).items():
            if callable(value) and getattr(value, "__module__", "") == module_name:
                defined.append(key)
        raise UnknownName(f"function in {file}", name, defined)
    try:
        inspect.signature(function).bind(*arguments)
    except TypeError as error:
        raise DataError(
            f"{name} in {file} cannot be called with ({', '.join(arguments)}), from which it has "
            f"to make a controller: {error}."
        ) from error
    return function


# --- state-space systems --------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SetpointInputs:
    """Inputs that are positions of the setpoint of the drives.

    Attributes:
        names: Names of the inputs, such as "x_set".
        b: Their columns in the next states, shape (k, names).
        d: Their columns in the commands, shape (outputs, names).
    """

    names: list[str]
    b: np.ndarray
    d: np.ndarray


@dataclass(frozen=True, eq=False)
class WrittenRest:
    """What `cranedyn.export.matlab.controller_to_matlab` writes beside the matrices: the rest about
    which a controller acts, and where its states begin and end.

    The shapes are checked where the crane is known. What a file leaves out is None: then it is as
    in a file of matrices alone.

    Attributes:
        rest: Coordinates and rates of the crane from which the inputs are deviations, z0 of the
            file, shape (2 n,).
        command: Commands from which the outputs are deviations, u0, shape (outputs,).
        initial: States of the controller at the start of a run, x0, shape (k,).
        anti_windup: Gain of what saturation takes away in the next states, shape (k, outputs).
        limit: Largest command that a drive takes, u_limits, shape (outputs,); inf for none.
    """

    rest: np.ndarray | None = None
    command: np.ndarray | None = None
    initial: np.ndarray | None = None
    anti_windup: np.ndarray | None = None
    limit: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class StateSpace:
    """A discrete state-space system x ← a x + b y, u = c x + d y, with named signals.

    Its inputs y are deviations of states of the crane from a rest or a motion, its outputs u
    deviations of the commands from those there. A feedback that pulls back has negative numbers in
    d.

    Attributes:
        a: Shape (k, k); without states k is 0.
        b: Shape (k, inputs).
        c: Shape (outputs, k).
        d: Shape (outputs, inputs).
        period: Control period [s]; None without states.
        inputs: Names of states of the crane, such as "phi" or "x_dot".
        outputs: Names of the commands: "T_gamma", "F_x", "F_l" for efforts, "x_ddot" and the like
            for accelerations, "x_dot_command" and the like for rates.
        setpoints: Further inputs that are setpoints; None if there are none, and the controller
            goes where the setpoint of the run is.
        written: What else a controller was written with; None for nothing.
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray
    period: float | None
    inputs: list[str]
    outputs: list[str]
    setpoints: SetpointInputs | None = None
    written: WrittenRest | None = None

    def drive(self, crane: Crane) -> Drive:
        """Return what its outputs are, by their names.

        Raises:
            UnknownName: If one is no command of the crane.
            CraneError: If they are commands of different kinds.
        """
        known = []
        for drive in get_args(Drive):
            commands = input_names(crane, drive)
            if set(self.outputs) <= set(commands):
                return drive
            known += commands
        for name in self.outputs:
            if name not in known:
                raise UnknownName("command", name, known)
        raise CraneError(
            f"The outputs {', '.join(self.outputs)} are commands of different kinds; allowed are "
            "efforts, accelerations or rates alone."
        )

    def controller(self, crane: Crane, about: State | Motion, dt: float = 5e-4) -> Controller:
        """Return the controller about a rest or a motion, with the commands that hold the crane
        there or make the motion added.

        A file of `controller_to_matlab` says itself about which rest it acts, and which commands
        hold the crane there; along a motion both are those of the motion.

        Args:
            crane: The crane.
            about: The rest or the motion.
            dt: Physics step of the run [s].

        Raises:
            UnknownName: If an input is no state of the crane, or an output no command.
            CraneError: As `linear_controller`.
            DataError: If its setpoint inputs neither leave it at its rest nor take it to the
                setpoint, see `_setpoint_source`.
        """
        written = WrittenRest() if self.written is None else self.written
        # Along a motion the deviations are those from the motion ("rest"), whatever the setpoint
        # of the run. About a rest they follow that setpoint ("run"), unless a file says otherwise.
        setpoint: SetpointSource = "run"
        if self.setpoints is not None:
            setpoint = self._setpoint_source(crane, self.setpoints)
        if isinstance(about, Motion):
            setpoint = "rest"
            first_state = State(about.q[0], about.v[0])
        else:
            if written.rest is not None:
                n = crane.layout.n
                rest = finite("z0 of the controller", written.rest, (2 * n,))
                about = State(rest[:n], rest[n:])
            first_state = about
        system = self if self.written is None else self._without_held(crane, first_state)
        # Matrices alone get the usual anti-windup of `linear_controller`.
        anti_windup: AntiWindup = "observer"
        if written.anti_windup is not None:
            anti_windup = written.anti_windup
        controller = linear_controller(
            crane,
            system.a,
            system.b,
            system.c,
            system.d,
            about=about,
            inputs=system.inputs,
            outputs=self.outputs,
            period=self.period,
            initial=written.initial,
            anti_windup=anti_windup,
            setpoint=setpoint,
            drive=self.drive(crane),
            dt=dt,
        )
        controller = self._with_limits(crane, controller, written)
        if isinstance(about, Motion):
            # Without states it is a table of gains, which any drive takes. The limits are for the
            # anti-windup of states.
            return controller if len(self.a) else controller.tracking
        return self._with_commands_at_rest(crane, controller, written)

    def _without_held(self, crane: Crane, state: State) -> StateSpace:
        """Return the system without the inputs that are held at a state, such as the stretch of a
        rigid rope. They are no inputs of a controller; `controller_to_matlab` names all states of
        the crane, and writes columns of zeros for them. One that is not zero is kept, and refused
        by `linear_controller`.
        """
        names = state_names(crane)
        held = {names[i] for i in held_states(crane, state)}
        columns = []
        for i, name in enumerate(self.inputs):
            if name not in held or self.b[:, i].any() or self.d[:, i].any():
                columns.append(i)
        inputs = [self.inputs[i] for i in columns]
        return replace(self, b=self.b[:, columns], d=self.d[:, columns], inputs=inputs)

    def _places(self, crane: Crane) -> list[int]:
        """Return which drives the outputs command, by their indices."""
        commands = input_names(crane, self.drive(crane))
        return [commands.index(name) for name in self.outputs]

    def _with_commands_at_rest(
        self, crane: Crane, controller: LinearController, written: WrittenRest
    ) -> LinearController:
        """Return a controller about a rest with the commands there that a file gives.

        Raises:
            OutOfRange: If one is not finite, or they have another shape.
        """
        if written.command is None:
            return controller
        places = self._places(crane)
        tracking = controller.tracking
        feed_forward = tracking.feed_forward.copy()
        feed_forward[0, places] = finite("u0 of the controller", written.command, (len(places),))
        tracking = replace(tracking, feed_forward=feed_forward)
        return replace(controller, tracking=tracking)

    def _with_limits(
        self, crane: Crane, controller: LinearController, written: WrittenRest
    ) -> LinearController:
        """Return a controller with the limits of its commands that a file gives.

        Raises:
            OutOfRange: If they have another shape, or one is not positive.
        """
        if written.limit is None:
            return controller
        name = "u_limits of the controller"
        places = self._places(crane)
        limit = controller.states.limit.copy()
        limit[places] = as_array(name, written.limit, (len(places),))  # inf is none
        if not (limit > 0.0).all():
            raise OutOfRange(name, limit.tolist(), "> 0")
        return replace(controller, states=replace(controller.states, limit=limit))

    def _setpoint_source(self, crane: Crane, setpoints: SetpointInputs) -> SetpointSource:
        """Return whose positions of the drives the controller acts about: those of its rest where
        the columns of its setpoints are zero, and those of the run where they are what takes the
        deviation from the setpoint.

        Raises:
            UnknownName: If a setpoint is that of no drive.
            DataError: If the columns are neither.
        """
        layout = crane.layout
        drives = [f"{joint.symbol}{_SETPOINT}" for joint in layout.driven]
        for name in setpoints.names:
            if name not in drives:
                raise UnknownName("setpoint", name, drives)
        columns = np.zeros((len(self.a) + len(self.outputs), layout.m))
        places = [drives.index(name) for name in setpoints.names]
        columns[:, places] = np.vstack([setpoints.b, setpoints.d])
        if not columns.any():
            return "rest"
        # A setpoint shifts the rest: drives stand elsewhere, and on a luffing crane the load hangs
        # at other angles. The deviations that count are the measured ones less that shift S s, so
        # that a system with the columns K for the states has -K S for the setpoints s.
        shift = at_rest_shifted(crane, np.eye(layout.m)).T
        by_state = np.zeros((len(columns), 2 * layout.n))
        names = state_names(crane)
        # Other inputs, such as commands on their way, have no setpoint.
        for i, name in enumerate(self.inputs):
            if name in names:
                by_state[:, names.index(name)] = np.append(self.b[:, i], self.d[:, i])
        expected = -by_state @ shift
        # The writer takes S as a difference of two rests, which rounds otherwise.
        if not np.allclose(columns, expected, rtol=1e-9, atol=1e-9 * np.abs(by_state).max()):
            raise DataError(
                f"The columns of {', '.join(setpoints.names)} are neither zero nor those of the "
                "deviation from the setpoint, so that the controller goes neither to its rest nor "
                "to the setpoint; a controller with setpoints of another kind is a function in "
                "Python."
            )
        return "run"


class _StateSpaceFile(ControllerFile):
    """A state-space system from a file."""

    def __init__(self, source: str) -> None:
        self.name = Path(source).stem
        self.source = source
        self._system = read_state_space(source)

    def make(self, crane: Crane, motion: Motion, dt: float = 5e-4) -> DrivenController:
        drive = self._system.drive(crane)
        about = motion if len(motion.q) > 1 else State(motion.q[0], motion.v[0])
        return DrivenController(self._system.controller(crane, about, dt), drive)


def read_state_space(file: str | Path) -> StateSpace:
    """Read a state-space system from a file that ends in .json or .mat.

    A file in JSON is an object with the matrices "A", "B", "C", "D" as lists of rows, the control
    period "dt" [s], and the lists "inputs" and "outputs" of names. A gain has "D" and the names
    alone.

    A file of MATLAB, up to version 7.2, has the variables A, B, C, D and Ts, and the cell arrays
    inputs and outputs; or the fields of an `ss` object, as ``s = get(K); save('k.mat', '-struct',
    's')`` writes them, with the names in InputName and OutputName.

    Inputs whose names end in "_set" are setpoints of the drives, see `SetpointInputs`. A file of
    MATLAB with such inputs may also have z0, u0, x0, anti_windup and u_limits, see `WrittenRest`.
    So `cranedyn.export.matlab.controller_to_matlab` writes a controller. Without such inputs, these
    variables may be anything of a workspace, and are not read.

    Raises:
        DataError: If it cannot be read, or something in it is missing or has another form.
    """
    if str(file).endswith(".mat"):
        content = _matlab_content(file)
    else:
        content = _json_content(file)
    inputs = _signal_names(file, "inputs", content["inputs"])
    outputs = _signal_names(file, "outputs", content["outputs"])
    matrices = {key: content[key] for key in "ABCD" if _has_elements(content[key])}
    if "D" not in matrices:
        raise DataError(
            f"{file} has no matrix D, with a row for each output and a column for each input; it "
            "is zero where the inputs act through the states alone."
        )
    d = _matrix(file, "D", matrices.pop("D"), len(outputs), len(inputs))
    is_setpoint = np.array([name.endswith(_SETPOINT) for name in inputs])
    if matrices:
        missing = [key for key in "ABC" if key not in matrices]
        if missing:
            raise DataError(f"{file} has no {', '.join(missing)}, but others of A, B and C.")
        count = len(_matrix(file, "A", matrices["A"], "rows", "columns"))
        a = _matrix(file, "A", matrices["A"], count, count)
        b = _matrix(file, "B", matrices["B"], len(a), len(inputs))
        c = _matrix(file, "C", matrices["C"], len(outputs), len(a))
        period = _period(file, content["dt"])
    else:
        if content["dt"] is not None:
            raise DataError(
                f"{file} has dt beside a gain, which has no states and so no period; leave it out."
            )
        a = np.zeros((0, 0))
        b = np.zeros((0, len(inputs)))
        c = np.zeros((len(outputs), 0))
        period = None
    setpoints = None
    written = None
    if is_setpoint.any():
        names = [name for name in inputs if name.endswith(_SETPOINT)]
        setpoints = SetpointInputs(names, b[:, is_setpoint], d[:, is_setpoint])
        written = _written_rest(content)
    return StateSpace(
        a=a,
        b=b[:, ~is_setpoint],
        c=c,
        d=d[:, ~is_setpoint],
        period=period,
        inputs=[name for name in inputs if not name.endswith(_SETPOINT)],
        outputs=outputs,
        setpoints=setpoints,
        written=written,
    )


def _written_rest(content: dict[str, Any]) -> WrittenRest | None:
    """Return what a controller was written with, by the keys of what a file holds; None if there is
    nothing.
    """
    if all(content.get(key) is None for key in _WRITTEN_IN_MATLAB):
        return None
    return WrittenRest(
        rest=_column(content.get("z0")),
        command=_column(content.get("u0")),
        initial=_column(content.get("x0")),
        anti_windup=content.get("anti_windup"),
        limit=_column(content.get("u_limits")),
    )


def _column(value: Any) -> np.ndarray | None:
    """Return a variable of MATLAB as a vector, which MATLAB has as a matrix of one column; None if
    there is none.
    """
    return None if value is None else np.ravel(value)


def _matrix(
    file: str | Path, key: str, value: Any, rows: int | str, columns: int | str
) -> np.ndarray:
    """Return a matrix of a file, checked, shape (rows, columns).

    Raises:
        DataError: If it is none, has another shape or is not finite.
    """
    try:
        return finite(f"{key} in {file}", value, (rows, columns))
    except CraneError as error:
        raise DataError(str(error)) from error


def _period(file: str | Path, value: Any) -> float:
    """Return the period of a system with states [s]; MATLAB has 0 for continuous time, and -1 for a
    period that is not given.

    Raises:
        DataError: If there is none.
    """
    if value is None or value in (0, -1):
        raise DataError(
            f"{file} has states in continuous time or without a period; make it one of the control "
            "period, by c2d in MATLAB or control.sample_system, and give the period as Ts in "
            "MATLAB or dt in JSON."
        )
    try:
        return number(f"period in {file}", value, "s", "> 0")
    except OutOfRange as error:
        raise DataError(str(error)) from error


def _has_elements(matrix: Any) -> bool:
    """Return whether a matrix is given and has elements."""
    return matrix is not None and np.size(np.asarray(matrix, dtype=object)) > 0


def _json_content(file: str | Path) -> dict[str, Any]:
    """Return what a file in JSON holds, by the keys of `_JSON_KEYS`.

    Raises:
        DataError: If it cannot be read, is no JSON object, or holds something else.
    """
    try:
        content = parse_json(read_text(file))
    except (ValueError, RecursionError) as error:
        raise DataError(f"Cannot read {file}: it is no JSON ({error}).") from error
    if not isinstance(content, dict):
        raise DataError(f"{file} is no JSON object with the keys {', '.join(_JSON_KEYS)}.")
    foreign = [key for key in content if key not in _JSON_KEYS]
    if foreign:
        raise DataError(
            f"{file} has the key {quoted(foreign[0])}; allowed are {', '.join(_JSON_KEYS)}."
        )
    return {key: content.get(key) for key in _JSON_KEYS}


def _matlab_content(file: str | Path) -> dict[str, Any]:
    """Return what a file of MATLAB holds, by the keys of `_JSON_KEYS` and `_WRITTEN_IN_MATLAB`.

    Raises:
        DataError: If it cannot be read, or the system has delays or a matrix E.
    """
    from scipy.io import loadmat

    wanted = ["A", "B", "C", "D", "E", "Ts", *_NAMES_IN_MATLAB, *_NAMES_IN_MATLAB.values()]
    wanted += [*_REFUSED_IN_MATLAB, *_WRITTEN_IN_MATLAB]
    try:
        variables = loadmat(io.BytesIO(read_bytes(file)), variable_names=wanted)
    except CraneError:
        raise
    except NotImplementedError as error:
        raise DataError(
            f"Cannot read {file}: it is of MATLAB 7.3; write one by save(…, '-v7')."
        ) from error
    except Exception as error:  # whatever a damaged file makes SciPy raise
        raise DataError(f"Cannot read {file}: it is no file of MATLAB ({error}).") from error
    for name in _REFUSED_IN_MATLAB:
        if np.any(_numbers(variables.get(name))):
            raise DataError(f"{file} has {name}, which is not read; absorb it by absorbDelay.")
    if _numbers(variables.get("E")).size:
        raise DataError(f"{file} has a matrix E; make the system explicit by ss(…, 'explicit').")
    content: dict[str, Any] = {}
    for key in [*"ABCD", *_WRITTEN_IN_MATLAB]:
        content[key] = variables.get(key)
    period = _numbers(variables.get("Ts"))
    # Every `ss` object has a period, also a gain, which needs none.
    is_gain = not any(_has_elements(content[key]) for key in "ABC")
    content["dt"] = float(period.ravel()[0]) if period.size == 1 and not is_gain else None
    for ours, matlabs in _NAMES_IN_MATLAB.items():
        content[ours] = variables.get(ours, variables.get(matlabs))
    return content


def _numbers(value: Any) -> np.ndarray:
    """Return a variable of MATLAB as real numbers, an empty array if it is none."""
    array = np.asarray(value)
    return array.astype(float) if array.dtype.kind in "biuf" else np.zeros(0)


def _signal_names(file: str | Path, kind: str, value: Any) -> list[str]:
    """Return the names of the inputs or outputs of a system: a list, or a cell array of MATLAB.

    Raises:
        DataError: If they are none.
    """
    names = []
    for entry in _entries(value):
        # An entry of a cell array is an array that holds a text.
        text = entry.item() if isinstance(entry, np.ndarray) and entry.size == 1 else entry
        names.append(text.strip() if isinstance(text, str) else "")
    if not names or "" in names:
        example = '["phi", "x_dot"]' if kind == "inputs" else '["T_gamma", "F_x", "F_l"]'
        where = f" or {_NAMES_IN_MATLAB[kind]}" if str(file).endswith(".mat") else ""
        raise DataError(f"{file} does not name its {kind}; {kind}{where} is a list like {example}.")
    for i, name in enumerate(names):
        if name in names[:i]:
            raise DataError(f"{file} has {name} twice among its {kind}.")
    return names


def _entries(value: Any) -> list[Any]:
    """Return the entries of a list, or of an array of MATLAB; none of anything else."""
    if isinstance(value, np.ndarray):
        return list(value.ravel())
    return value if isinstance(value, list) else []


def controllers_by_name(sources: Sequence[str]) -> dict[str, ControllerFile]:
    """Return controllers of one's own by their names.

    Raises:
        DataError: If two of them have the same name, or as `open_controller`.
    """
    opened: dict[str, ControllerFile] = {}
    for source in sources:
        controller = open_controller(source)
        if controller.name in opened:
            raise DataError(
                f"{opened[controller.name].source} and {source} are both called "
                f"{controller.name}; rename one of them."
            )
        opened[controller.name] = controller
    return opened
