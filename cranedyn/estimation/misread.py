"""A sensor of the hoist that is wrong: a controller that takes the cable for shorter than it is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cranedyn.clocks import Clocked
from cranedyn.controllers.affine import Affine, Dynamic, Stateful, affine_form
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.model.crane import Crane


@dataclass(frozen=True, eq=False)
class Misread:
    """A controller whose hoist reads less than the cable has: l = (1 + share) reading + offset.

    Attributes:
        crane: The crane.
        controller: Controller that acts on the reading.
        share: Share by which the cable is longer than the reading.
        offset: Length by which it is longer besides, wherever the hoist stands [m].
    """

    crane: Crane
    controller: Controller
    share: float
    offset: float

    def begin_run(self, t: float, control_period: float) -> None:
        """Begin a run, see `cranedyn.clocks.Clocked`."""
        if isinstance(self.controller, Clocked):
            self.controller.begin_run(t, control_period)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return the command, shape (m,)."""
        hoist = self.crane.layout.index("l")
        q = state.q.copy()
        v = state.v.copy()
        q[hoist] = (q[hoist] - self.offset) / (1.0 + self.share)
        v[hoist] /= 1.0 + self.share
        return self.controller(t, State(q, v), setpoint)

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine | None:
        """Return the affine form, see `cranedyn.controllers.affine`.

        The inner controller sees the reading (z - added) / scale of a state z. Its deviation from
        the setpoint s is (z - added) / scale - s = (z - (scale s + added)) / scale: that of the
        cable itself from another setpoint, by a gain divided by the scale.
        """
        layout = self.crane.layout
        form = affine_form(self.controller, times, positions, 2 * layout.n)
        if form is None:
            return None
        scale = np.ones(2 * layout.n)
        added = np.zeros(2 * layout.n)
        # Of the cable length and of its rate, which stands n numbers behind.
        scale[layout.index("l") :: layout.n] += self.share
        added[layout.index("l")] = self.offset
        of_drives = scale[layout.drives]
        states = form.states
        if states is not None:
            # The states of the controller are driven by the same deviation.
            states = replace(states, b=states.b / scale)
        return replace(
            form,
            gain=form.gain / scale,
            setpoint=scale * form.setpoint + added,
            target=of_drives * form.target + added[layout.drives],
            integral_gain=form.integral_gain / of_drives,
            integral=of_drives * form.integral,
            states=states,
        )

    def resume(self, t: float, integral: np.ndarray) -> None:
        """Resume a run, see `cranedyn.controllers.affine.Stateful`."""
        if isinstance(self.controller, Stateful):
            scale = 1.0 + self.share * self.crane.layout.along("l")
            self.controller.resume(t, integral / scale)

    def resume_states(self, t: float, states: np.ndarray) -> None:
        """Resume a run, see `cranedyn.controllers.affine.Dynamic`."""
        if isinstance(self.controller, Dynamic):
            self.controller.resume_states(t, states)
