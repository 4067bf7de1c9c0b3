"""Break the physics, one thing at a time, and see that the tests notice: ``python -m
tests.mutations``.

Each mutation is made in a copy of the project; the test that stands beside it runs there, in a
process forked from this one, and must fail. Exit code 1 if one survives.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import hypothesis
import pytest
from hypothesis import Phase

ROOT = Path(__file__).parent.parent

# As in the tests, before anything imports NumPy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

SHARED = (
    "llvmlite.binding",
    "matplotlib.figure",
    "pinocchio",
    "scipy.integrate",
    "scipy.signal",
    "trimesh",
)
"""What is imported once for all tests: slow, never broken here, and without threads of its own,
which a forked process would miss.
"""

NOT_COPIED = (".git", ".venv", "out", "docs", ".*cache", "*.egg-info")


class Mutation(NamedTuple):
    """What is broken: a text in a file that is there exactly once, however its lines are broken,
    what takes its place, and which test should see it, as file::name without "test_".
    """

    what: str
    file: str
    old: str
    new: str
    test: str


URDF = "urdf/tower_crane.urdf.xacro"

MUTATIONS = (
    Mutation(
        "the axis of the tangential swing is turned round",
        URDF,
        'axis xyz="0 1 0"',
        'axis xyz="0 -1 0"',
        "crane::the_default_crane_has_the_numbers_of_the_article",
    ),
    Mutation(
        "the inertia of the upper structure stands at the wrong axis",
        URDF,
        'iyy="${0.02 * of_upper}" izz="${of_upper}"',
        'iyy="${of_upper}" izz="${0.02 * of_upper}"',
        "crane::a_urdf_by_another_hand_moves_alike",
    ),
    Mutation(
        "the payload has no rotational inertia",
        URDF,
        'ixx="$(arg payload_ixx)" iyy="$(arg payload_iyy)" izz="$(arg payload_izz)"',
        'ixx="0.0" iyy="0.0" izz="0.0"',
        "dynamics::accelerations_are_those_of_the_lagrangian_by_hand",
    ),
    Mutation(
        "Coriolis and centrifugal forces are missing",
        "cranedyn/dynamics/drives.py",
        "pin.aba(self.model, self._data, q, v, tau",
        "pin.aba(self.model, self._data, q, 0.0 * v, tau",
        "simulate::the_loop_is_sample_hold_velocities_positions",
    ),
    Mutation(
        "joint damping is ignored",
        "cranedyn/dynamics/drives.py",
        "tau = self._tau - self._damping * v",
        "tau = 1.0 * self._tau",
        "simulate::the_loop_is_sample_hold_velocities_positions",
    ),
    Mutation(
        "joint damping is ignored where motion is prescribed",
        "cranedyn/dynamics/pinocchio.py",
        "needed = pin.rnea(model, data, q, v, a) - joint",
        "needed = pin.rnea(model, data, q, v, a)",
        "dynamics::prescribed_motion_and_the_efforts_it_costs_are_one_motion",
    ),
    Mutation(
        "dampers push the way a joint moves",
        "cranedyn/dynamics/joint_forces.py",
        "resisting = -(self.damping * v)",
        "resisting = self.damping * v",
        "dynamics::damping_is_a_force_against_the_own_velocity_of_each_joint",
    ),
    Mutation(
        "a step is a thousandth too long",
        "cranedyn/simulation/engine.py",
        "np.full(setting.crane.layout.n, setting.clocks.dt)",
        "np.full(setting.crane.layout.n, 1.001 * setting.clocks.dt)",
        "simulate::the_loop_is_sample_hold_velocities_positions",
    ),
    Mutation(
        "explicit Euler takes the place of semi-implicit",
        "cranedyn/dynamics/integrators.py",
        "        v = step_rates(v, acceleration(q, v))\n        q = step_coordinates(q, v)",
        "        q, v = step_coordinates(q, v), step_rates(v, acceleration(q, v))",
        "integrator::the_energy_of_a_large_swing_ripples_but_does_not_drift",
    ),
    Mutation(
        "a command is held one step too long",
        "cranedyn/simulation/engine.py",
        "q, v = self._steps(q, v, self._setting.clocks.steps)",
        "q, v = self._steps(q, v, self._setting.clocks.steps + 1)",
        "simulate::the_loop_is_sample_hold_velocities_positions",
    ),
    Mutation(
        "a command acts one control period late",
        "cranedyn/dynamics/drives.py",
        "self._tau[self._layout.drives] = self._effort",
        "self._tau[self._layout.drives] = getattr(self, '_before', self._effort)\n"
        "        self._before = self._effort",
        "simulate::the_loop_is_sample_hold_velocities_positions",
    ),
    Mutation(
        "the limits of the drives are not kept",
        "cranedyn/dynamics/drives.py",
        "np.minimum(np.maximum(command, self._least), self._largest)",
        "1.0 * command",
        "simulate::the_loop_is_sample_hold_velocities_positions",
    ),
    Mutation(
        "the two swings have each other's inertia where motion is prescribed",
        "cranedyn/dynamics/pinocchio.py",
        "(m12 * open_j - m22 * open_i)",
        "(m12 * open_j - m11 * open_i)",
        "dynamics::prescribed_motion_moves_the_drives_as_asked_and_asks_nothing_of_the_swing_joints",
    ),
    Mutation(
        "work is counted with the positions that run ahead of the velocities",
        "cranedyn/simulation/log.py",
        "middle = q - self._setting.lead * v",
        "middle = q",
        "simulate::under_a_constant_force_the_ledger_closes_to_rounding",
    ),
    Mutation(
        "a force on the payload acts on the trolley",
        "cranedyn/dynamics/pinocchio.py",
        "pairs = zip(force, ",
        "pairs = zip(force[::-1], ",
        "wind::a_force_does_the_work_of_its_way",
    ),
    Mutation(
        "buffers pull",
        "cranedyn/dynamics/joint_forces.py",
        "return chosen(pushing * beyond < 0.0, pushing, 0.0)",
        "return pushing",
        "validity::a_buffer_pushes_but_never_pulls",
    ),
    Mutation(
        "the rope may push",
        "cranedyn/dynamics/validity.py",
        'yield Bound(layout.role("hoist", "The rope"), tension, 0.0,',
        'yield Bound(layout.role("hoist", "The rope"), tension, -math.inf,',
        "validity::a_buffer_at_the_shortest_cable_stops_the_hook_block_but_cannot_push_the_load",
    ),
    Mutation(
        "the load feels nothing of the buffer at the shortest cable",
        "cranedyn/simulation/engine.py",
        "float(self._external.stops.effort(*self.state)[hoist])",
        "min(float(self._external.stops.effort(*self.state)[hoist]), 0.0)",
        "validity::a_buffer_at_the_shortest_cable_stops_the_hook_block_but_cannot_push_the_load",
    ),
    Mutation(
        "an integrator goes by the period of its table",
        "cranedyn/controllers/integral.py",
        "integral = self.integral + error * self._elapsed",
        "integral = self.integral + error * self.tracking.period",
        "controllers::an_integrator_goes_by_the_period_of_its_loop",
    ),
    Mutation(
        "a table is read at the row before",
        "cranedyn/references/tabulated.py",
        "return value + share * (table[row + 1] - value) if share else value",
        "return value",
        "controllers::between_rows_tracking_goes_on_straight_lines",
    ),
    Mutation(
        "a shaped motion keeps its last velocity after its end",
        "cranedyn/references/shaped.py",
        "(times >= 0.0) & (times < self.end)",
        "(times >= 0.0) & (times < np.inf)",
        "references::a_reference_rests_before_it_begins_and_after_its_end",
    ),
    Mutation(
        "a drive that slows down obeys the joystick's next push besides",
        "cranedyn/planning/joystick.py",
        "            speed += lasts",
        "            speed = 0.0 if not target else lasts",
        "control::an_operator_who_changes_his_mind_is_never_obeyed_beyond_the_limits",
    ),
    Mutation(
        "turbulence is on straight lines between its values",
        "cranedyn/disturbances/wind.py",
        "/ math.sqrt(1.0 - lost)",
        "/ math.sqrt(1.0 - 0.0 * lost)",
        "wind::turbulence_has_its_intensity_at_every_time_however_long_the_step",
    ),
    Mutation(
        "a reference waits twice as far ahead of a drive that stalls",
        "cranedyn/dynamics/converters.py",
        "lead = self.accelerations[i] * self.lags[i]",
        "lead = 2.0 * self.accelerations[i] * self.lags[i]",
        "converters::a_reference_waits_for_a_drive_that_stalls",
    ),
    Mutation(
        "commands of rates look ahead to the beginning of what they hold for",
        "cranedyn/dynamics/converters.py",
        "self.delay_steps(0.0, control_period) + 0.5",
        "self.delay_steps(0.0, control_period) + 0.0",
        "velocity_command::an_effort_becomes_the_rate_that_its_acceleration_leads_to",
    ),
    Mutation(
        "a ramp gives its acceleration up as if steps had no length",
        "cranedyn/dynamics/converters.py",
        "0.5 * (square_root(jump * jump + 8.0 * self.jerks[i] * distance) - jump)",
        "0.5 * square_root(8.0 * self.jerks[i] * distance)",
        "converters::no_ramp_overshoots_or_exceeds_its_limits",
    ),
    Mutation(
        "converters hear commands a control period early",
        "cranedyn/dynamics/converters.py",
        "math.ceil(self.delay / control_period - 1e-9)",
        "math.floor(self.delay / control_period - 1e-9)",
        "converters::commands_are_late_by_the_delay_and_drives_go_on_until_they_are_heard",
    ),
    Mutation(
        "a drive that stalls is not felt by the others",
        "cranedyn/dynamics/converters.py",
        "matrix = np.array([[saturated[i] * inertia[i, j] * saturated[j]",
        "matrix = np.array([[saturated[i] * inertia[i, j] * saturated[j] * (i == j)",
        "converters::no_drive_exerts_more_than_it_can_and_the_others_do_as_they_want",
    ),
    Mutation(
        "a late measurement counts as one of now",
        "cranedyn/estimation/observer.py",
        "self._correct(self._since[0][0] if self._since else row, state)",
        "self._correct(row, state)",
        "sensing::a_delay_known_to_the_observer_is_predicted_away",
    ),
    Mutation(
        "an observer believes what a drive cannot give",
        "cranedyn/estimation/observer.py",
        "command.clip(-self.effort_limit, self.effort_limit)",
        "command.clip(-np.inf, np.inf)",
        "sensing::the_observer_knows_what_the_drives_cannot_give",
    ),
    Mutation(
        "noise of the sensors does not make an observer less sure",
        "cranedyn/estimation/observer.py",
        "residual @ covariance @ residual.T + gain @ noise @ gain.T",
        "residual @ covariance @ residual.T",
        "sensing::the_filters_gain_tends_to_that_of_the_dual_riccati_equation",
    ),
    Mutation(
        "how sure an observer of the load is moves on to first order",
        "cranedyn/estimation/load_filter.py",
        "self._identity + step + step @ step / 2.0",
        "self._identity + step",
        "load_estimate::the_covariance_of_a_load_at_rest_goes_on_to_second_order_in_the_period",
    ),
    Mutation(
        "a reading of the cable says nothing of its share",
        "cranedyn/estimation/load_filter.py",
        "by[read, -1] = -values[read] / scale",
        "by[read, -1] = 0.0",
        "load_estimate::what_the_sensors_should_say_has_the_derivatives_that_differences_give",
    ),
    Mutation(
        "the rate of a longer cable does not move its motion",
        "cranedyn/estimation/load_estimate.py",
        "half, turned = beyond**2 / 2.0, acceleration * beyond + rate**2",
        "half, turned = beyond**2 / 2.0, acceleration * beyond",
        "load_estimate::rates_and_accelerations_of_a_cable_twice_as_long_are_how_its_motion_changes",
    ),
    Mutation(
        "the Riccati sweep forgets the cost of effort on the way",
        "cranedyn/controllers/lqr.py",
        "effort_weight + input_cost @ b[k]",
        "0.5 * effort_weight + input_cost @ b[k]",
        "control::the_finite_horizon_tends_to_the_algebraic_riccati_equation",
    ),
    Mutation(
        "a shaper for a moving cable weighs its parts the wrong way round",
        "cranedyn/references/shaped.py",
        "phase, length) ** 0.25",
        "phase, length) ** -0.25",
        "control::a_shaper_for_a_moving_cable_keeps_the_way_and_leaves_less_than_one_for_a_fixed_cable",
    ),
    Mutation(
        "a flat path takes the load for a point",
        "cranedyn/references/flat.py",
        "inertia = (crane.payload_inertia[0, 0] + sum(crane.dummy_inertia) / 2.0) / "
        "crane.payload_mass",
        "inertia = 0.0",
        "control::a_flat_slew_leaves_the_swing_that_the_documents_tell_of",
    ),
    Mutation(
        "what the drives did does not move the swing that is expected",
        "cranedyn/compiled/horizon/control.py",
        "done = (v[drives] - rates_before) / period",
        "done = 0.0 * (v[drives] - rates_before)",
        "horizon::what_it_believes_of_the_swing_is_what_swings_where_sensors_are_exact",
    ),
    Mutation(
        "a plan for converters begins with the rates measured",
        "cranedyn/compiled/horizon/control.py",
        "v[drives], self.programme.rate_share",
        "v[drives], 1.0",
        "horizon::drives_twice_as_late_as_believed_leave_no_swing",
    ),
    Mutation(
        "a predictive controller learns from what it did not read",
        "cranedyn/compiled/horizon/control.py",
        "gain = learns * (programme.share / programme.period)",
        "gain = programme.share / programme.period",
        "horizon::what_was_not_read_teaches_nothing_of_what_disturbs",
    ),
    Mutation(
        "a planned hoist may let go of the load",
        "cranedyn/compiled/horizon/control.py",
        "acceleration[hoist] = code.chosen(over > 0.0, reduced, acceleration[hoist])",
        "acceleration[hoist] = acceleration[hoist]",
        "horizon::it_never_commands_a_slack_rope_however_fast_the_hoist_may_be[motion]",
    ),
    Mutation(
        "what disturbs a drive is not taken off",
        "cranedyn/compiled/horizon/control.py",
        "crane.answer(q, v, acceleration - estimate, None)",
        "crane.answer(q, v, acceleration, None)",
        "horizon::a_load_of_another_mass_ends_where_it_shall_since_what_disturbs_is_estimated",
    ),
    Mutation(
        "the Coriolis term of the recursions has the wrong sign",
        "cranedyn/plant/rigid_body.py",
        "sliding = 2.0 * (tree.rotation[i] @ (along * rate))",
        "sliding = -2.0 * (tree.rotation[i] @ (along * rate))",
        "compiled::a_run_of_many_blocks_is_the_same",
    ),
    Mutation(
        "what hangs on its rope has no mass across it",
        "cranedyn/plant/rigid_body.py",
        "np.multiply.outer(moved, moved) * tree.mass[last]",
        "np.multiply.outer(moved, moved) * 0.0",
        "rigid_body::a_load_on_its_rope_moves_as_in_pinocchio_wherever_its_centre_is",
    ),
    Mutation(
        "an angle that turned too far for a series keeps what the series gave",
        "cranedyn/compiled/kernel.py",
        "self._keep_angle(i, turn.refine(pairs[i]))",
        "self._keep_angle(i, pairs[i])",
        "turned_angles::long_steps_that_turn_far_are_those_of_pinocchio",
    ),
    Mutation(
        "compiled robots are taken as they come",
        "cranedyn/compiled/model.py",
        "if off := rigid_body.disagreement(",
        "if off := 0.0 * rigid_body.disagreement(",
        "compiled_model::code_that_moves_otherwise_is_refused",
    ),
    Mutation(
        "compiled cranes are taken as they come",
        "cranedyn/compiled/verify.py",
        "if off := rigid_body.disagreement(",
        "if off := 0.0 * rigid_body.disagreement(",
        "compiled::code_that_moves_otherwise_is_refused",
    ),
    Mutation(
        "compiled cranes have no joint damping",
        "cranedyn/plant/plant.py",
        "effort = self.joint.effort(q, v)",
        "effort = 0.0 * v",
        "compiled::a_run_of_many_blocks_is_the_same",
    ),
    Mutation(
        "compiled forces act on the wrong body",
        "cranedyn/plant/plant.py",
        "ExternalForce(body, lever, force) for body",
        "ExternalForce(min(body, 3), lever, force) for body",
        "compiled::disturbances_that_are_no_forces_end_both_runs_in_the_same_words",
    ),
    Mutation(
        "compiled buffers push outwards",
        "cranedyn/plant/plant.py",
        "effort[drives] + self.stops.effort(q, v)",
        "effort[drives] - self.stops.effort(q, v)",
        "compiled::both_engines_record_the_same",
    ),
    Mutation(
        "compiled buffers do half of their work",
        "cranedyn/compiled/step.py",
        "work = work + 0.5 * dt *",
        "work = work + 0.25 * dt *",
        "compiled::both_engines_record_the_same",
    ),
    Mutation(
        "a stepping rule that looks at numbers becomes code all the same",
        "cranedyn/compiled/engine.py",
        "        check_rule(setting.integrator)\n",
        "",
        "compiled::a_stepping_rule_without_code_is_refused_before_anything_is_asked_whatever_its_name",
    ),
    Mutation(
        "a compiled integrator grows beyond the limit of its drive",
        "cranedyn/compiled/kernel.py",
        "integrals[i] = code.chosen(free, integrated, integrals[i])",
        "integrals[i] = integrated",
        "compiled::what_an_integrator_remembers_is_what_the_plain_loop_leaves_it",
    ),
    Mutation(
        "what a compiled loop integrated is forgotten",
        "cranedyn/compiled/engine.py",
        "if isinstance(controller, Stateful):",
        "if False:",
        "compiled::a_run_of_many_blocks_is_the_same",
    ),
    Mutation(
        "a compiled loop logs efforts a period late",
        "cranedyn/compiled/kernel.py",
        "row = [*q, *v, *command, *effort, *before,",
        "row = [*q, *v, *command, *before, *effort,",
        "compiled::a_run_of_many_blocks_is_the_same",
    ),
    Mutation(
        "compiled RK4 gives way to small steps too late",
        "cranedyn/compiled/step.py",
        "rough = code.either(*beyond(before.q), *beyond(smooth.q))",
        "rough = code.either(*beyond(before.q))",
        "compiled::both_engines_record_the_same",
    ),
    Mutation(
        "RK4 weighs its accelerations wrongly",
        "cranedyn/dynamics/integrators.py",
        "v = step_rates(v, (a1 + 2.0 * (a2 + a3) + a4) / 6.0)",
        "v = step_rates(v, (a1 + a2 + a3 + 3.0 * a4) / 6.0)",
        "compiled::a_stepping_rule_of_ones_own_runs_in_both_engines",
    ),
    Mutation(
        "cranes of a batch have each other's numbers",
        "cranedyn/compiled/batch.py",
        "group_lanes([varied[crane_index]], lanes)",
        "group_lanes([varied[crane_index[::-1]]], lanes)",
        "batch::each_crane_of_a_batch_does_what_it_does_alone",
    ),
    Mutation(
        "compiled code begins a piece of a control period with control again",
        "cranedyn/compiled/kernel.py",
        "with code.when(code.builder.not_(begun)):",
        "with code.when(code.builder.or_(code.builder.not_(begun), begun)):",
        "compiled_binding::a_run_in_pieces_is_the_same_to_the_bit",
    ),
    Mutation(
        "tables are read beyond their end",
        "cranedyn/compiled/binding.py",
        "final + length > total",
        "final > total",
        "compiled_binding::only_counts_within_the_arrays_are_bound",
    ),
    Mutation(
        "cranes of a fleet have the effort limits of the first",
        "cranedyn/compiled/fleet.py",
        "for crane in self.cranes])[kinds]",
        "for crane in self.cranes])[0 * kinds]",
        "compiled_fleet::efforts_are_cut_to_the_limits_of_each_crane_as_in_simulate",
    ),
    Mutation(
        "a swing of a batch counts as residual a row late",
        "cranedyn/compiled/batch.py",
        "math.ceil(periods - 1e-6)",
        "math.ceil(periods - 1e-6) + 1",
        "batch::the_summary_is_that_of_the_recorded_rows",
    ),
    Mutation(
        "springs are not felt",
        "cranedyn/dynamics/joint_forces.py",
        "return resisting if self.springs is None else resisting + self.springs.effort(q)",
        "return resisting",
        "cranes::a_crane_hangs_where_nothing_accelerates_and_its_energy_has_the_springs",
    ),
    Mutation(
        "springs are forgotten where a crane is linearised",
        "cranedyn/dynamics/pinocchio.py",
        "by_q = by_q - inverse_mass @ crane.springs.tangent(state.q)",
        "by_q = by_q",
        "cranes::the_linear_crane_has_its_springs",
    ),
    Mutation(
        "the energy of springs is not in the ledger",
        "cranedyn/dynamics/pinocchio.py",
        "return rigid + float(crane.springs.energy(state.q)) if crane.springs.any else rigid",
        "return rigid",
        "cranes::a_crane_hangs_where_nothing_accelerates_and_its_energy_has_the_springs",
    ),
    Mutation(
        "a rope is as stiff at any length",
        "cranedyn/model/springs.py",
        "effort[stretch] = effort[stretch] - stiffness * strain",
        "effort[stretch] = effort[stretch] - stiffness * q[stretch] / 10.0",
        "cranes::springs_push_down_their_energy_and_the_tangent_is_how_they_do",
    ),
    Mutation(
        "a rope that stretches does not pull at its drum",
        "cranedyn/model/springs.py",
        "effort[length] = effort[length] + 0.5 * stiffness * strain * strain",
        "effort[length] = effort[length]",
        "cranes::springs_push_down_their_energy_and_the_tangent_is_how_they_do",
    ),
    Mutation(
        "the tension of a rope that stretches is the force of its drum",
        "cranedyn/dynamics/joint_forces.py",
        "if springs is not None and springs.rope is not None:\n        stretch, length, stiffness "
        "= springs.rope\n        return",
        "if False:\n        stretch, length, stiffness = springs.rope\n        return",
        "cranes::a_rope_stretches_by_its_load_over_its_stiffness_at_its_length",
    ),
    Mutation(
        "springs are counted in seconds where time is counted in steps",
        "cranedyn/dynamics/joint_forces.py",
        "Springs(stiffness * force, rest, scaled)",
        "Springs(stiffness, rest, scaled)",
        "cranes::forces_in_steps_are_the_same_forces",
    ),
    Mutation(
        "free modes forget the springs",
        "cranedyn/dynamics/linearisation.py",
        "rest_stiffness(crane.model, data, crane.springs, q)[block]",
        "pin.computeGeneralizedGravityDerivatives(crane.model, data, q)[block]",
        "cranes::free_modes_are_normal_and_keep_their_amplitudes",
    ),
    Mutation(
        "an elastic crane starts where its springs are slack",
        "cranedyn/model/load.py",
        "return replace(crane, start=State(hanging, np.zeros(layout.n)))",
        "return crane",
        "cranes::a_crane_hangs_where_nothing_accelerates_and_its_energy_has_the_springs",
    ),
    Mutation(
        "the inertia of a motor is not in the model",
        "cranedyn/model/load.py",
        "    model.armature = read_armature(robot, names)\n",
        "",
        "cranes::springs_push_down_their_energy_and_the_tangent_is_how_they_do",
    ),
    Mutation(
        "the slung load hangs at the hook",
        URDF,
        '<xacro:payload_inertial below="$(arg sling_length)"/>',
        "<xacro:payload_inertial/>",
        "cranes::springs_push_down_their_energy_and_the_tangent_is_how_they_do",
    ),
    Mutation(
        "every joint counts as driven",
        "cranedyn/model/layout.py",
        "return self._where(lambda joint: not joint.driven)",
        "return self._where(lambda joint: False)",
        "cranes::a_crane_hangs_where_nothing_accelerates_and_its_energy_has_the_springs",
    ),
    Mutation(
        "a spring may push away from its rest",
        "cranedyn/model/springs.py",
        """number(f"spring stiffness of {name}", text, unit, ">= 0")""",
        """number(f"spring stiffness of {name}", text, unit)""",
        "layout::a_spring_that_is_none_is_refused",
    ),
    Mutation(
        "one joint may play two parts",
        "cranedyn/model/joints.py",
        "        if joint in roles:\n",
        "        if False:\n",
        "layout::roles_are_named_once_and_known",
    ),
    Mutation(
        "the own mast is no obstacle",
        "cranedyn/planning/clearance.py",
        "Field([*solids, *((MAST, shape) for shape in self.bodies.mast)])",
        "Field([*solids])",
        "clearance::the_hook_keeps_from_the_own_mast_by_the_way_between_them",
    ),
    Mutation(
        "hoisting moves the load straight down though its rope leans",
        "cranedyn/planning/clearance.py",
        "2.0 * aside * across * hoisted",
        "0.0 * aside * across * hoisted",
        "clearance::hoisting_along_a_leaning_rope_moves_the_load_no_farther_than_said",
    ),
    Mutation(
        "a rope has no width",
        "cranedyn/planning/bodies.py",
        "falls=float(np.ptp(block[:, :2], axis=0).max()) / 2.0",
        "falls=1e-3 * float(np.ptp(block[:, :2], axis=0).max()) / 2.0",
        "clearance::rope_and_trolley_keep_from_a_post_beside_them_by_what_the_urdf_draws",
    ),
    Mutation(
        "a parked neighbour has no rope",
        "cranedyn/planning/neighbour.py",
        "return [shape.T for shape in shapes] + [np.array(rope)]",
        "return [shape.T for shape in shapes]",
        "clearance::the_rope_of_a_parked_neighbour_is_in_the_way",
    ),
    Mutation(
        "a run is proven by the lesser half of its way",
        "cranedyn/planning/proof.py",
        "bound = max(moved[middle] - moved[low], moved[high] - moved[middle]) + bend",
        "bound = min(moved[middle] - moved[low], moved[high] - moved[middle]) + bend",
        "proof::a_motion_that_rests_and_then_enters_a_wall_is_not_proven",
    ),
    Mutation(
        "perturbed lifts jump from row to row",
        "cranedyn/planning/perturbed.py",
        "bounds[k] = clearance.margin(batch.q[i, k]) - step[i, k]",
        "bounds[k] = clearance.margin(batch.q[i, k])",
        "lift::a_lift_that_passes_a_plate_between_two_rows_kept_is_near_to_it",
    ),
    Mutation(
        "the mean wind is as strong as the gust",
        "cranedyn/lifting/wind_limit.py",
        """"wind_m_s": speed / GUST_FACTOR""",
        """"wind_m_s": speed / 1.0""",
        "judgement::the_wind_limit_is_that_of_the_worst_gust_whatever_is_drawn",
    ),
    Mutation(
        "drives of a plan reach no farther than at their rates at both ends",
        "cranedyn/planning/drive_trajectory.py",
        "self._rate(np.concatenate([[first, last], between]))",
        "self._rate(np.array([first, last]))",
        "least_time::drives_reach_no_farther_between_two_times_than_is_said",
    ),
    Mutation(
        "a rope may lean as it will between the points of a plan",
        "cranedyn/planning/optimal.py",
        "if tilt.max() > clearance.site.swing:",
        "if False:",
        "least_time::a_motion_whose_rope_leans_more_than_the_site_allows_is_not_returned",
    ),
    Mutation(
        "a load that hangs in the wind leans against it",
        "cranedyn/planning/perturbed.py",
        "start[:, joints.tangential_swing] = -np.arctan2(",
        "start[:, joints.tangential_swing] = np.arctan2(",
        "lift::the_wind_at_the_start_leans_the_load_to_its_lee_and_meets_its_broad_side",
    ),
    Mutation(
        "a path takes its corners at the rates of its legs",
        "cranedyn/planning/curve.py",
        "begins = self.knots[:-1] - np.append(0.0, self.widths)",
        "begins = self.knots[:-1]",
        "proof::before_a_corner_a_path_already_reaches_the_next_way_and_after_it_still_the_last",
    ),
    Mutation(
        "a load goes on a straight line from row to row",
        "cranedyn/planning/proof.py",
        "bend, stretches = _FASTEST * period**2 / 8.0,",
        "bend, stretches = 0.0 * period,",
        "proof::between_two_rows_alike_a_load_may_have_been_thrown_as_far_as_it_can",
    ),
    Mutation(
        "a chart is a straight line of loads",
        "cranedyn/lifting/chart.py",
        "np.interp(radius, self.radii, self.radii * self.rated)",
        "radius * np.interp(radius, self.radii, self.rated)",
        "chart::between_its_points_the_moment_is_a_straight_line",
    ),
    Mutation(
        "a buffer takes none of the tension of the rope",
        "cranedyn/lifting/loads.py",
        "hoist + (cable_buffers(crane, moving.q, moving.v) if buffers else 0.0)",
        "hoist + 0.0",
        "loads::a_rope_pulls_what_hangs_on_it_where_a_buffer_takes_of_it_or_adds_to_it",
    ),
    Mutation(
        "a rope leads to the other side",
        "cranedyn/lifting/loads.py",
        "np.arctan2(_along(rope, aside), -rope[:, 2])",
        "-np.arctan2(_along(rope, aside), -rope[:, 2])",
        "loads::a_rope_that_leads_aside_pulls_by_its_tangent_and_twists_the_tower",
    ),
    Mutation(
        "the tower stands on its corners mirrored",
        "cranedyn/lifting/loads.py",
        "(m_y * x - m_x * y)",
        "(m_y * x + m_x * y)",
        "loads::corners_carry_the_whole_and_turn_with_the_jib",
    ),
    Mutation(
        "a cut of the crane forgets that what hangs beyond it is accelerated",
        "cranedyn/lifting/wrench.py",
        "efforts = rigid_body.tree_inverse_dynamics(tree, frames, rows(v), rows(a), beyond)",
        "efforts = rigid_body.tree_inverse_dynamics(tree, frames, rows(v), rows(0.0 * a), beyond)",
        "chart::a_load_at_rest_takes_its_share_and_one_that_is_lifted_faster_more",
    ),
    Mutation(
        "a rope may be slack where the hoist is strong",
        "cranedyn/lifting/checks.py",
        "slack > 0.0 and snag > 0.0",
        "slack > 0.0 or snag > 0.0",
        "judgement::a_lift_that_holds_goes_and_each_thing_that_does_not_stops_it",
    ),
    Mutation(
        "few lifts prove a risk as well as many",
        "cranedyn/lifting/checks.py",
        "high <= required.risk",
        "_ <= required.risk",
        "judgement::too_few_lifts_prove_no_risk_though_none_came_too_near",
    ),
    Mutation(
        "a load is as heavy as entered",
        "cranedyn/lifting/checks.py",
        "utilisation = (1.0 + spread) * float(analysis.utilisation.max())",
        "utilisation = float(analysis.utilisation.max())",
        "judgement::a_lift_that_holds_goes_and_each_thing_that_does_not_stops_it",
    ),
    Mutation(
        "a wind is borne up to the weakest gust that is not",
        "cranedyn/lifting/checks.py",
        "limit >= required.wind",
        "broken >= required.wind",
        "judgement::a_wind_is_borne_and_a_ground_bears_up_to_what_was_found_and_no_further",
    ),
    Mutation(
        "errors with a memory count as if they had none",
        "cranedyn/identification/estimate.py",
        "covariance += (1.0 - lag / (reach + 1.0)) * (cross + cross.T)",
        "covariance += 0.0 * (cross + cross.T)",
        "estimate::coloured_errors_widen_the_intervals_and_never_narrow_them",
    ),
    Mutation(
        "how a record begins counts as known before it is made",
        "cranedyn/identification/preflight.py",
        "total += full[:count, :count] - full[:count, count:] @ beside @ full[count:, :count]",
        "total += full[:count, :count]",
        "preflight::margins_foretold_are_those_that_come_out",
    ),
    Mutation(
        "intervals are left open on one side",
        "cranedyn/identification/estimate.py",
        "student.ppf(0.5 + CONFIDENCE / 2.0",
        "student.ppf(CONFIDENCE",
        "preflight::margins_foretold_are_those_that_come_out",
    ),
    Mutation(
        "noise of a record is taken for its second differences",
        "cranedyn/identification/estimate.py",
        "np.mean(bent**2, axis=1) / 6.0",
        "np.mean(bent**2, axis=1) / 1.0",
        "preflight::margins_foretold_are_those_that_come_out",
    ),
    Mutation(
        "a chunk file of a sweep may stand for another",
        "cranedyn/sweep/folder.py",
        "if label != self._label(index):",
        "if False:",
        "sweep_integrity::a_part_that_stands_for_another_counts_as_not_done",
    ),
    Mutation(
        "a sweep goes on with other code",
        "cranedyn/sweep/folder.py",
        "first.sources.items() ^ now.sources.items()",
        "first.sources.items() ^ first.sources.items()",
        "sweep_integrity::a_study_edited_between_two_runs_is_not_mixed_in",
    ),
    Mutation(
        "a damaged chunk file of a sweep counts as done",
        "cranedyn/sweep/folder.py",
        "if not is_whole(content):",
        "if False:",
        "sweep_integrity::a_damaged_part_is_named_and_computed_again",
    ),
    Mutation(
        "a mesh may lie anywhere",
        "cranedyn/recording/shapes.py",
        "if not path.is_relative_to(folder.resolve()):",
        "if False:",
        "meshes::a_mesh_that_cannot_be_drawn_is_refused",
    ),
    Mutation(
        "the drives of an environment brake as if steps had no length",
        "cranedyn/bridges/task.py",
        "self._most * (t - self._dt) * rate",
        "self._most * t * rate",
        "gymnasium::drives_keep_their_limits_and_stop_before_the_ends_of_their_ranges",
    ),
    Mutation(
        "the first command in ROS is no effort at all",
        "cranedyn/bridges/ros2.py",
        'states["effort"] = joint.holding',
        'states["effort"] = 0.0',
        "ros2::the_efforts_before_the_first_command_hold_the_crane_where_it_starts",
    ),
    Mutation(
        "the keyframe of MuJoCo lets go of the load",
        "cranedyn/bridges/mjcf.py",
        "repr(joint.holding) for joint in moving",
        "repr(0.0 * joint.holding) for joint in moving",
        "mjcf::a_crane_hangs_still_from_its_keyframe_on",
    ),
    Mutation(
        "a turned inertia is turned the wrong way for MuJoCo",
        "cranedyn/bridges/mjcf.py",
        "tensor = turn @ tensor @ turn.T",
        "tensor = turn.T @ tensor @ turn",
        "mjcf::springs_motors_and_turned_inertias_are_carried",
    ),
    Mutation(
        "Gazebo drops the inertia of a motor",
        "cranedyn/bridges/joints.py",
        'float(dynamics.get("armature", "0"))',
        'float(dynamics.get("armature", "0")) < 0.0',
        "ros2::the_inertia_of_a_motor_which_gazebo_does_not_know_is_refused",
    ),
    Mutation(
        "static frames of a recording reach nobody who comes late",
        "cranedyn/bridges/mcap.py",
        "reliability: 1, durability: 1",
        "reliability: 1, durability: 2",
        "mcap::what_is_published_once_plays_back_to_who_comes_late",
    ),
    Mutation(
        "a recording tells what acted as what was commanded",
        "cranedyn/bridges/mcap.py",
        '"effort": run.command[k].tolist()',
        '"effort": run.effort[k].tolist()',
        "mcap::a_command_that_a_drive_cuts_is_told_as_it_was_given",
    ),
    Mutation(
        "a unit forgets that its model ceased to hold",
        "cranedyn/bridges/fmi.c",
        "data->invalid |= !isinf",
        "data->invalid = !isinf",
        "fmi::a_unit_says_once_the_model_no_longer_holds",
    ),
    Mutation(
        "a unit begins at 0 whatever it is told",
        "cranedyn/bridges/fmi.c",
        "unit->data.value[0] = start;",
        "unit->data.value[0] = 0.0 * start;",
        "fmi::time_goes_on_from_the_start_that_the_importer_names",
    ),
    Mutation(
        "a unit that diverges goes on",
        "cranedyn/bridges/fmi.c",
        "if (!(fastest < 1e6))",
        "if (fastest > 1e60)",
        "fmi::a_run_that_diverges_is_an_error_that_says_when",
    ),
    Mutation(
        "margins overlook half of the sampling rate",
        "cranedyn/bridges/margins.py",
        "gains = np.append(gains, [-1.0 / end] if end < 0.0 else [])",
        "gains = np.append(gains, [])",
        "margins::a_drive_is_unstable_just_beyond_what_its_margins_say",
    ),
    Mutation(
        "an exporter of another package replaces one of ours",
        "cranedyn/plugins.py",
        "value = _own(kind).get(name) or _foreign(kind).get(name)",
        "value = _foreign(kind).get(name) or _own(kind).get(name)",
        "plugins::an_exporter_of_another_package_writes_what_it_says_and_replaces_none_of_ours",
    ),
)


def mutated(text: str, mutation: Mutation) -> str:
    """A text with the mutation; how its lines are broken does not matter.

    Raises:
        SystemExit: If what it replaces is not there exactly once.
    """
    marks = re.findall(r"\w+|[^\w\s]", mutation.old)
    pattern = r"\s*".join(r"(?:,\s*)?" * (mark in ")]}") + re.escape(mark) for mark in marks)
    found = re.findall(pattern, text)
    if len(found) != 1:
        raise SystemExit(
            f"{mutation.file} holds {len(found)} times what mutation {mutation.what!r} replaces, "
            "not once."
        )
    before = mutation.old[: len(mutation.old) - len(mutation.old.lstrip())]
    after = mutation.old[len(mutation.old.rstrip()) :]
    return text.replace(found[0], mutation.new.removeprefix(before).removesuffix(after))


def put(path: Path, text: str) -> None:
    """Write a source file, and have no bytecode of what stood there before."""
    path.write_text(text, encoding="utf-8")
    Path(importlib.util.cache_from_source(str(path))).unlink(missing_ok=True)


def started(test: str, copy: Path) -> int:
    """Have a forked process run a test in a copy, which says in a file "said" what came of it;
    returns the number of the process.
    """
    file, name = test.split("::")
    path = next((copy / "tests").rglob(f"test_{file}.py"))
    if process := os.fork():
        return process
    status = -1
    try:
        said = os.open(copy / "said", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for stream in (1, 2):
            os.dup2(said, stream)
        os.chdir(copy)
        os.environ |= {"PYTHONPATH": str(copy), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
        sys.path.insert(0, str(copy))
        del sys.modules["tests"]
        there = ["-p", "no:cacheprovider", f"--basetemp={copy / 'temporary'}", "-o", "addopts="]
        status = pytest.main(["-q", "-x", *there, f"{path}::test_{name}"])
        sys.stdout.flush()
    finally:
        # Whatever happens: what else there is to end belongs to the process it was forked from.
        os._exit(status)


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    made = argparse.ArgumentParser(
        prog="python -m tests.mutations",
        description="Break the physics and see that the tests notice.",
    )
    made.add_argument(
        "--jobs", type=int, default=os.cpu_count(), metavar="N", help="how many at a time"
    )
    made.add_argument(
        "--only", metavar="WORDS", default="", help="only mutations with these words in their name"
    )
    options = made.parse_args(argv)
    chosen = [mutation for mutation in MUTATIONS if options.only in mutation.what]
    for module in SHARED:
        importlib.import_module(module)
    # What fails need not be made small; other settings of the tests are added to this one.
    hypothesis.settings.register_profile("first", phases=[Phase.explicit, Phase.generate])
    hypothesis.settings.load_profile("first")
    waiting, running, survived = chosen[::-1], dict[int, tuple[Mutation, Path, str]](), 0
    with tempfile.TemporaryDirectory() as parent:
        free = [Path(parent, str(i)) for i in range(options.jobs)]
        while waiting or running:
            if waiting and free:
                mutation, copy = waiting.pop(), free.pop()
                if not copy.exists():
                    shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*NOT_COPIED))
                before = (copy / mutation.file).read_text("utf-8")
                put(copy / mutation.file, mutated(before, mutation))
                running[started(mutation.test, copy)] = mutation, copy, before
                continue
            process, status = os.wait()
            mutation, copy, before = running.pop(process)
            put(copy / mutation.file, before)
            free.append(copy)
            found = os.waitstatus_to_exitcode(status) == 1
            said = (copy / "said").read_text("utf-8", "replace")
            words = [line for line in said.splitlines() if line.startswith(("FAILED", "ERROR"))]
            by = words[0].split(" - ")[0] if words else said[-600:]
            survived += not found
            print(f"{'caught' if found else 'SURVIVES':9} {mutation.what}: {by}", flush=True)
    print(f"{len(chosen) - survived} of {len(chosen)} mutations caught.")
    return 1 if survived else 0


if __name__ == "__main__":
    sys.exit(main())
