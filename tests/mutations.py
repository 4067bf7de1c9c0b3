"""Break the physics, one thing at a time, and see that the tests notice: ``python -m
tests.mutations``.

Each mutation is made in a copy of the project; its test runs there, in a process forked from this
one, and must fail. The table printed has its processor time. Exit code 1 if a mutation survives.
"""

from __future__ import annotations

import argparse
import gc
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
    "asyncua",
    "casadi",
    "llvmlite.binding",
    "matplotlib.figure",
    "mujoco",
    "pandas",
    "pinocchio",
    "pyarrow.dataset",
    "rich.progress",
    "scipy.integrate",
    "scipy.signal",
    "toppra",
    "trimesh",
    "xacro",
    "yourdfpy",
)
"""Modules imported once for all tests: slow, never mutated, and without threads, which a forked
process would miss.
"""

NOT_COPIED = (".git", ".venv", "out", "docs", ".*cache", "*.egg-info")


class Mutation(NamedTuple):
    """A fault: code that a file holds exactly once, its replacement, and the test that must fail,
    as file::name without "test_".
    """

    file: str
    fault: str
    test: str
    old: str
    new: str


TABLE = r"""
cranedyn/bridges/mcap.py
* a run of another crane is written
? mcap::a_run_of_another_crane_is_refused_with_the_coordinates_of_both
- trajectory.check_coordinates(crane.layout.columns()["q"])
+ pass
cranedyn/model/pendulum.py
* a crane is silent of inertias that are not those of its load
? pendulum::a_small_load_with_the_inertias_of_a_large_one_is_told_by_its_crane
- if abs(ratio - 1.0) <= LARGEST_DIFFERENCE:
+ if True:
cranedyn/bridges/page.py
* the force of a rope whose coordinate is a height is negative
? page::a_crane_without_visuals_and_roles_has_a_load_colours_and_the_force_of_its_rope
- return 1.0 if (before - after) / step >= 0.0 else -1.0
+ return 1.0
cranedyn/bridges/control.py
* a feedback forgets what its own memory does to the next command
? control::a_gain_of_the_commands_on_their_way_moves_the_crane_as_the_closed_linear_loop
- moved_on - newest @ gain_of_memory
+ moved_on
* a feedback of commands on their way runs with any delay
? control::a_gain_of_the_commands_on_their_way_is_refused_a_run_with_another_delay
- if steps != self.delay:
+ if False:
cranedyn/verdict.py
* a claim that was not judged hides one that fails
? verdict::checks_hold_together_only_if_there_are_some_and_all_hold
- if Verdict.FAILS in verdicts:
+ if Verdict.FAILS in verdicts and Verdict.NOT_JUDGED not in verdicts:
* where nothing was checked, everything holds
? verdict::checks_hold_together_only_if_there_are_some_and_all_hold
- if verdicts == {Verdict.HOLDS} else Verdict.NOT_JUDGED
+ if verdicts <= {Verdict.HOLDS} else Verdict.NOT_JUDGED
* a number that is none is a pass by its truth value
? verdict::what_is_no_condition_is_no_verdict
- if not isinstance(holds, bool | np.bool_):
+ if False:
cranedyn/assumptions.py
* a default is as good as an entered value
? verdict::a_default_is_never_taken_for_an_entered_value
- if a.origin is Origin.DEFAULT]
+ if a.origin is None]
urdf/tower_crane.urdf.xacro
* the axis of the tangential swing is turned round
? crane::the_default_crane_has_the_numbers_of_the_article
- axis xyz="0 1 0"
+ axis xyz="0 -1 0"
* the inertia of the upper structure stands at the wrong axis
? crane::a_urdf_by_another_hand_moves_alike
- iyy="${0.02 * of_upper}" izz="${of_upper}"
+ iyy="${of_upper}" izz="${0.02 * of_upper}"
* the payload has no rotational inertia
? dynamics::accelerations_are_those_of_the_lagrangian_by_hand_less_damping
- ixx="$(arg payload_ixx)" iyy="$(arg payload_iyy)" izz="$(arg payload_izz)"
+ ixx="0.0" iyy="0.0" izz="0.0"
* the slung load hangs at the hook
? cranes::springs_push_down_their_energy_and_the_tangent_is_how_they_do
- <xacro:payload_inertial below="${sling}"/>
+ <xacro:payload_inertial/>
cranedyn/dynamics/drives.py
* Coriolis and centrifugal forces are missing
? simulate::the_plain_loop_of_the_example_does_the_same_to_round_off
- pin.aba(self.model, self._data, q, v, tau
+ pin.aba(self.model, self._data, q, 0.0 * v, tau
* joint damping is ignored
? simulate::the_plain_loop_of_the_example_does_the_same_to_round_off
- tau = self._tau - self._damping * v
+ tau = 1.0 * self._tau
* a command acts one control period late
? simulate::the_plain_loop_of_the_example_does_the_same_to_round_off
- self._tau[self._layout.drives] = self._effort
+ self._tau[self._layout.drives] = getattr(self, '_before', self._effort)
+         self._before = self._effort
* the limits of the drives are not kept
? simulate::efforts_beyond_the_limits_are_cut_and_the_log_shows_it
- np.minimum(np.maximum(command, self._least), self._largest)
+ 1.0 * command
cranedyn/dynamics/pinocchio.py
* joint damping is ignored where motion is prescribed
? dynamics::prescribed_motion_and_the_efforts_it_costs_are_one_motion
- needed = pin.rnea(model, data, q, v, a) - joint
+ needed = pin.rnea(model, data, q, v, a)
* the two swings have each other's inertia where motion is prescribed
? dynamics::prescribed_motion_moves_the_drives_as_asked_and_asks_nothing_of_the_swing_joints
- (m12 * open_j - m22 * open_i)
+ (m12 * open_j - m11 * open_i)
* a force on the payload acts on the trolley
? wind::a_force_does_the_work_of_its_way
- pairs = zip(force,
+ pairs = zip(force[::-1],
* springs are forgotten where a crane is linearised
? cranes::the_linear_crane_has_its_springs
- by_q = by_q - inverse_mass @ stiffness
+ by_q = by_q
* the energy of springs is not in the ledger
? cranes::a_crane_hangs_where_nothing_accelerates_and_its_energy_has_the_springs
- return rigid + float(crane.springs.energy(state.q)) if crane.springs.any else rigid
+ return rigid
cranedyn/dynamics/joint_forces.py
* dampers push the way a joint moves
? dynamics::accelerations_are_those_of_the_lagrangian_by_hand_less_damping
- resisting = -self.resistance(v)
+ resisting = self.resistance(v)
* dry friction drives a joint
? friction::a_sliding_cart_stops_where_its_kinetic_energy_is_spent[pinocchio]
- resistance[joint] = resistance[joint] + self._dry_friction(joint, v[joint])
+ resistance[joint] = resistance[joint] - self._dry_friction(joint, v[joint])
* the smooth law of friction has twice its width
? friction::a_cart_under_less_than_its_friction_creeps_at_the_rate_of_the_law[25.0]
- (rate / square_root(rate * rate + width * width))
+ (rate / square_root(rate * rate + 4.0 * width * width))
* what dry friction dissipates is not in the ledger
? friction::friction_dissipates_what_the_motion_loses
- power = (self.resistance(v) * v).sum(axis=0) if self.friction else self.damping @ (v * v)
+ power = self.damping @ (v * v)
* buffers pull
? validity::a_buffer_pushes_but_never_pulls
- return chosen(pushing * beyond < 0.0, pushing, 0.0)
+ return pushing
* springs are not felt
? cranes::a_crane_hangs_where_nothing_accelerates_and_its_energy_has_the_springs
- effort = resisting + self.springs.effort(q)
+ effort = resisting
* the tension of a rope that stretches is the force of its drum
? cranes::a_rope_stretches_by_its_load_over_its_stiffness_at_its_length
- if joint.rope is not None:
+ if False:
* a damper of the rope pushes
? cranes::a_load_thrown_up_is_free_until_its_rope_is_taut_again[pinocchio-3000.0]
- spring + chosen(damper < 0.0, damper, 0.0)
+ spring
cranedyn/dynamics/drives.py
* a taut rope lets its stretch move
? slack::a_load_falls_freely_until_the_rope_catches_it_and_then_hangs[pinocchio]
- self._free = self._free_when_taut if taut else self._answering
+ self._free = self._answering
* an impact pushes what drives prescribe
? slack::an_impact_keeps_the_momentum_of_all_that_is_free
- change = follow_drives(model, data, q, still, change, weight, self._free_when_taut)
+ change = follow_drives(model, data, q, still, change, weight, np.arange(5))
cranedyn/compiled/step.py
* a lane whose slack rope becomes taut goes on falling
? slack::a_load_falls_freely_until_the_rope_catches_it_and_then_hangs[compiled]
- loose_end.q[stretch] < 0.0
+ loose_end.q[stretch] < 9.0
* the change of a rope is found by halves only once
? slack::both_engines_go_through_the_same_phases[motion-inextensible]
- _TRIES = 10
+ _TRIES = 1
cranedyn/model/mimics.py
* followers have no inertia for their leaders
? mimics::accelerations_are_those_of_pinocchios_own_mimic_joints[0]
- reduced[leader, :] = reduced[leader, :] + reduced[follower, :] * ratio
+ reduced[leader, :] = reduced[leader, :] + 0.0 * ratio
* the weight of followers is not felt
? mimics::accelerations_are_those_of_pinocchios_own_mimic_joints[0]
- gathered[leader] = gathered[leader] + forces[follower] * ratio
+ gathered[leader] = gathered[leader] + 0.0 * ratio
* a leader may drive its follower out of its range
? mimics::a_range_that_a_follower_cuts_is_said
- low = max(lower[leader], min(at_lower, at_upper))
- high = min(upper[leader], max(at_lower, at_upper))
+ low = lower[leader]
+ high = upper[leader]
* a follower of a follower has the offset of its own only
? mimics::followers_are_neither_drives_nor_passive
- offset = mimic.ratio * above.offset + mimic.offset
+ offset = mimic.offset
cranedyn/model/locked.py
* a locked joint is held at zero
? locked::a_locked_crane_has_the_inertia_of_the_free_one_at_that_coordinate
- moved = coordinate * axis / np.linalg.norm(axis)
+ moved = 0.0 * axis / np.linalg.norm(axis)
* what mimics a locked joint stays where it was
? locked::what_mimics_a_locked_joint_is_held_with_it
- notes += _lock(robot, moving, follower, ratio * coordinate + offset)
+ notes += _lock(robot, moving, follower, offset)
cranedyn/model/mjcf.py
* joints are where their reference posture is, whatever their reference value
? mjcf::a_random_model_is_what_mujoco_compiles[2]
- back = -float(description["reference"]) * axis
+ back = 0.0 * axis
* a model that acts otherwise is not noticed
? mjcf::a_model_whose_joints_do_otherwise_is_refused
- if not difference <= _ACCELERATION_TOLERANCE * max(largest, _MIN_ACCELERATION):
+ if not difference <= max(largest, _MIN_ACCELERATION):
* a file may be anywhere
? mjcf::what_no_crane_is_is_refused_by_name[file elsewhere]
- if not (home / folder / value).resolve().is_relative_to(home):
+ if not (home / folder / value).resolve().is_absolute():
cranedyn/model/mjcf_compiler.py
* the gear of an actuator does not count
? mjcf::the_effort_of_a_drive_is_that_of_its_actuator[gear='30' ctrlrange='-25 25'-750.0-]
- ends = sorted((force.low * gear, force.high * gear))
+ ends = sorted((force.low, force.high))
* a load that stands is read as one that hangs
? mjcf::what_no_crane_is_is_refused_by_name[load that stands]
- if not all(moves) and upward > MIN_SUPPORT_NORMAL:
+ if False:
* a tendon with a spring is left out
? mjcf::what_no_crane_is_is_refused_by_name[tendon]
- model.tendon_stiffness[tendon] != 0.0
+ False
cranedyn/model/friction.py
* friction has no width, so that it holds nothing
? friction::the_width_is_the_rate_that_friction_takes_off_in_the_stopping_time
- stopping = STOPPING_TIME * interaction * mobility
+ stopping = 0.01 * STOPPING_TIME * interaction * mobility
* the record of a run forgets friction
? friction::friction_survives_the_record_of_a_run
- text = dynamics.get("friction", "0")
+ text = dynamics.get("rubbing", "0")
cranedyn/plant/plant.py
* an impact takes twice its energy
? plant::an_impact_takes_the_energy_that_rates_before_and_after_differ_by
- return after, change @ (mass @ (v + 0.5 * change))
+ return after, change @ (mass @ (v + change))
* drag takes a load along that moves in still air
? plant::drag_in_still_air_holds_a_load_back_and_wind_takes_it_along
- drag_force(area, wind - velocity)
+ drag_force(area, wind + velocity)
* buffers pull a drive out of its range
? plant::buffers_push_a_drive_back_into_its_range
- effort[drives] + self.stops.effort(q, v)
+ effort[drives] - self.stops.effort(q, v)
* a taut rope pulls where it is slack
? plant::an_inextensible_rope_holds_while_it_pulls_and_falls_free_while_it_does_not
- pull = -(mass[stretch] @ still[0] + resisting[stretch])
+ pull = mass[stretch] @ still[0] + resisting[stretch]
* the ground of a load is that of the crane
? plant::conditions_tell_what_the_model_does_not_hold_for
- level=0.0 if self.contacts is None else self.contacts.level
+ level=0.0
* efforts that drives do not have are none of the model
? plant::conditions_tell_what_the_model_does_not_hold_for
- needed=None if self.drive == "effort" else needed
+ needed=None
* a load that hangs askew swings about plumb
? plant::a_load_that_hangs_askew_swings_about_where_it_hangs
- i: q[i] - rest_angle
+ i: q[i]
* the energy of springs is left out
? plant::energy_is_that_of_pinocchio_and_of_springs
- rigid if self.joint.springs is None else rigid + self.joint.springs.energy(q)
+ rigid
cranedyn/plant/cranes.py
* numbers that are no polynomials pass
? load_cranes::a_description_that_is_no_polynomial_of_its_arguments_is_refused
- if not (np.abs(expected - rows[i]) <= _AGREES * size)[certain].all():
+ if False:
* a rate at the start is a coordinate
? load_cranes::starts_are_coordinates_and_rates_by_name
- (q if name == symbol else v)[:, layout.index(symbol)] = value
+ q[:, layout.index(symbol)] = value
cranedyn/plant/plant.py
* a load on two falls yaws freely in code
? springs::a_lane_of_a_batch_yaws_as_its_crane_does_alone
- falls._replace(stiffness=yaw_stiffness[0])
+ falls._replace(stiffness=0.0 * yaw_stiffness[0])
* an impact in code is elastic
? slack::a_load_falls_freely_until_the_rope_catches_it_and_then_hangs[compiled]
- change[stretch] = -v[stretch]
+ change[stretch] = -2.0 * v[stretch]
cranedyn/theory.py
* a sheave takes nothing
? reeving::each_sheave_passes_on_its_share_of_the_pull[0.9-4]
- return math.expm1(falls * loss) / (falls * math.expm1(loss))
+ return 1.0
cranedyn/model/springs.py
* springs are counted in seconds where time is counted in steps
? cranes::forces_in_steps_are_the_same_forces
- self.stiffness * force,
+ self.stiffness,
* two falls do not pull the hoist harder while the load yaws
? cranes::springs_push_down_their_energy_and_the_tangent_is_how_they_do
- effort[falls.length] + falls.energy(q) / q[falls.length]
+ effort[falls.length]
* two falls are as far from their middle as from each other
? springs::the_period_is_that_of_two_falls_but_for_what_is_left_out[0.01]
- (0.5 * falls.spacing) ** 2
+ falls.spacing**2
* two falls carry the hook only
? springs::a_hook_on_two_falls_is_where_it_hangs_on_one
- for body in list(model.subtrees[falls.length + 1])
+ for body in [falls.yaw + 1]
cranedyn/dynamics/joint_forces.py
* a slack rope keeps its strain energy
? cranes::a_load_thrown_up_is_free_until_its_rope_is_taut_again[pinocchio-3000.0]
- damper = self.tension(q, v) - stiffness * self.rope.strain(q)
+ damper = self.damping[stretch] * v[stretch]
cranedyn/simulation/engine.py
* a step is a thousandth too long
? simulate::the_plain_loop_of_the_example_does_the_same_to_round_off
- np.full(setting.crane.layout.n, setting.clocks.dt)
+ np.full(setting.crane.layout.n, 1.001 * setting.clocks.dt)
* a command is held one step too long
? simulate::the_plain_loop_of_the_example_does_the_same_to_round_off
- q, v = self._steps(q, v, self._setting.clocks.steps)
+ q, v = self._steps(q, v, self._setting.clocks.steps + 1)
* the load feels nothing of the buffer at the shortest cable
? validity::a_buffer_at_the_shortest_cable_stops_the_hook_block_but_cannot_push_the_load
- float(self._external.stops.effort(*self.state)[hoist])
+ min(float(self._external.stops.effort(*self.state)[hoist]), 0.0)
* the ground does not count its work
? contact::both_engines_let_a_box_fall_tip_and_slide_alike
- self._buffer_work += float(external.ground_effort @ moved)
+ self._buffer_work += 0.0
cranedyn/dynamics/contact.py
* the anchor of a sliding point forgets its damper
? contact::the_spring_of_a_sliding_point_carries_what_its_damper_leaves_of_the_friction
- -(f + self.slip_damping * r) / self.stiffness
+ -f / self.stiffness
* a point that sticks is not damped
? contact::friction_that_sticks_is_a_critically_damped_spring
- 2.0 * mass * omega,
+ 0.0 * mass * omega,
* a rope that leans does not lift off-lead
? contact::a_taut_rope_that_leans_lifts_off_lead_and_so_does_a_load_that_slides
- ((speeds > SLIDES) | (lean > LEANS))
+ (speeds > SLIDES)
* corners in the air slide on the ground
? contact::a_taut_rope_that_leans_lifts_off_lead_and_so_does_a_load_that_slides
- np.where(touches, np.hypot(*velocity[:2]), 0.0)
+ np.hypot(*velocity[:2])
* a platform is turned the other way
? contact::a_platform_is_turned_from_x_towards_y
- ((cosine, sine), (-sine, cosine))
+ ((cosine, -sine), (sine, cosine))
* a beam above the ground has no underside
? contact::a_body_above_the_ground_has_an_underside_and_one_on_the_ground_has_none
- if f.normal[2] > -1.0 or -f.offset > level
+ if f.normal[2] > -1.0
* the moments of a box are those of another
? contact::a_box_of_a_crane_has_the_moments_of_its_sides_and_hangs_amid_its_top
- xx, yy, zz = y + z, x + z, x + y
+ xx, yy, zz = x + z, y + z, x + y
* a load that is put on the ground stands still
? contact::a_load_that_is_put_on_the_ground_keeps_its_rates
- return State(q, state.v)
+ return State(q, 0.0 * state.v)
* the ground is at the foot of the crane
? contact::the_ground_is_at_any_height_and_a_hull_is_like_the_platform_of_its_corners
- (Face((0.0, 0.0, 1.0), level),)
+ (Face((0.0, 0.0, 1.0), 0.0),)
* a wall ends where the ground begins
? contact::the_ground_is_at_any_height_and_a_hull_is_like_the_platform_of_its_corners
- f.normal[2] > -1.0 or -f.offset > level
+ True
* a load without restitution rebounds
? contact::a_load_without_restitution_stays_where_it_falls
- damping_ratio(max(self.restitution, _DEAD))
+ damping_ratio(max(self.restitution, 0.3))
* the ground pulls a load that leaves it
? contact::a_box_on_the_ground_meets_its_closed_forms
- chosen(push > 0.0, push, 0.0)
+ push
* friction is twice as large
? contact::a_box_on_the_ground_meets_its_closed_forms
- self.friction * load
+ 2.0 * self.friction * load
* a load that sticks creeps
? contact::a_box_on_the_ground_meets_its_closed_forms
- -(self.stiffness * s + self.slip_damping * r)
+ -(self.slip_damping * r)
* a platform has no sides
? contact::a_box_is_stopped_by_the_side_of_a_platform_and_stands_on_its_top
- return (Face((0.0, 0.0, 1.0), self.height), *sides)
+ return (Face((0.0, 0.0, 1.0), self.height),)
* a load falls into the seam of two platforms
? contact::a_box_stands_and_slides_on_a_seam_of_two_platforms_as_on_one
- chosen(covered, face[0] + _COVERED, exit_depth)
+ exit_depth
cranedyn/model/crane.py
* two falls carry nothing
? springs::two_falls_carry_the_load_that_replaces_that_of_the_crane
- self.springs.carrying(self.model)
+ self.springs
cranedyn/dynamics/integrators.py
* explicit Euler takes the place of semi-implicit
? integrator::the_energy_of_a_large_swing_ripples_but_does_not_drift
- v = step_rates(v, acceleration(q, v))
- q = step_coordinates(q, v)
+ q, v = step_coordinates(q, v), step_rates(v, acceleration(q, v))
* RK4 weighs its accelerations wrongly
? compiled::a_stepping_rule_of_ones_own_runs_in_both_engines
- v = step_rates(v, (a1 + 2.0 * (a2 + a3) + a4) / 6.0)
+ v = step_rates(v, (a1 + a2 + a3 + 3.0 * a4) / 6.0)
cranedyn/simulation/log.py
* work is counted with the positions that run ahead of the velocities
? simulate::under_a_constant_force_the_ledger_closes_to_rounding
- middle = (q - self._setting.lead * v)[:, self._crane.layout.drives]
+ middle = q[:, self._crane.layout.drives]
cranedyn/dynamics/validity.py
* the rope may push
? validity::a_buffer_at_the_shortest_cable_stops_the_hook_block_but_cannot_push_the_load
- yield Bound(layout.role("hoist", "The rope"), tension, 0.0,
+ yield Bound(layout.role("hoist", "The rope"), tension, -math.inf,
cranedyn/controllers/affine.py
* a compiled integrator grows beyond the limit of its drive
? compiled::what_an_integrator_remembers_is_what_the_plain_loop_leaves_it
- chosen(error * total < 0.0, next_integral, integral)
+ next_integral
cranedyn/controllers/integral.py
* an integrator goes by the period of its table
? controllers::an_integrator_goes_by_the_period_of_its_loop
- integral = self.integral + error * self._elapsed
+ integral = self.integral + error * self.tracking.period
cranedyn/references/simple.py
* the quickest drive alone has to keep its acceleration
? limits::the_shortest_section_is_that_of_the_drive_that_needs_most
- np.sqrt(PEAK_ACCELERATION * path / a).max()
+ np.sqrt(PEAK_ACCELERATION * path / a).min()
* instants of a block are those of the first block
? references::many_times_at_once_are_setpoint_as_each_by_itself
- rows = block(k - k % _BLOCK)
+ rows = block(0)
cranedyn/references/tabulated.py
* a table is read at the row before
? controllers::between_rows_tracking_goes_on_straight_lines
- return value + share * (table[row + 1] - value) if share else value
+ return value
cranedyn/references/shaped.py
* a damped swing decays by its ratio alone
? shapers::a_shaper_leaves_nothing_of_a_damped_swing_and_the_whole_of_the_way
- return math.exp(-math.pi * ratio / math.sqrt(1.0 - ratio**2))
+ return math.exp(-math.pi * ratio)
* a shaped motion keeps its last velocity after its end
? references::a_reference_rests_before_it_begins_and_after_its_end
- (times >= 0.0) & (times < self.end)
+ (times >= 0.0) & (times < np.inf)
* a shaper for a moving cable weighs its parts the wrong way round
? control::a_shaper_for_a_moving_cable_keeps_the_way_and_leaves_less_than_one_for_a_fixed_cable
- phase, length) ** 0.25
+ phase, length) ** -0.25
cranedyn/planning/joystick.py
* a drive that slows down obeys the joystick's next push besides
? control::an_operator_who_changes_his_mind_is_never_obeyed_beyond_the_limits
- return speed + change
+ return change if target else 0.0
cranedyn/disturbances/wind.py
* turbulence is on straight lines between its values
? wind::turbulence_has_its_intensity_at_every_time_however_long_the_step
- / math.sqrt(1.0 - lost)
+ / math.sqrt(1.0 - 0.0 * lost)
cranedyn/dynamics/converters.py
* a reference waits twice as far ahead of a drive that stalls
? converters::a_reference_waits_for_a_drive_that_stalls
- lead = self.accelerations[i] * self.lags[i]
+ lead = 2.0 * self.accelerations[i] * self.lags[i]
* commands of rates look ahead to the beginning of what they hold for
? velocity_command::an_effort_becomes_the_rate_that_its_acceleration_leads_to
- self.delay_steps(0.0, control_period) + 0.5
+ self.delay_steps(0.0, control_period) + 0.0
* a ramp gives its acceleration up as if steps had no length
? converters::no_ramp_overshoots_or_exceeds_its_limits
- 0.5 * (square_root(jump * jump + 8.0 * self.jerks[i] * distance) - jump)
+ 0.5 * square_root(8.0 * self.jerks[i] * distance)
* converters hear commands a control period early
? converters::commands_are_late_by_the_delay_and_drives_go_on_until_they_are_heard
- math.ceil(self.delay / control_period - 1e-9)
+ math.floor(self.delay / control_period - 1e-9)
* a drive that stalls is not felt by the others
? converters::no_drive_exerts_more_than_it_can_and_the_others_do_as_they_want
- matrix = np.array([[saturated[i] * inertia[i, j] * saturated[j]
+ matrix = np.array([[saturated[i] * inertia[i, j] * saturated[j] * (i == j)
cranedyn/estimation/observer.py
* a late measurement counts as one of now
? sensing::a_delay_known_to_the_observer_is_predicted_away
- self._correct(self._since[0].row if self._since else row, state)
+ self._correct(row, state)
* an observer believes what a drive cannot give
? sensing::the_observer_knows_what_the_drives_cannot_give
- command.clip(-self.effort_limit, self.effort_limit)
+ command.clip(-np.inf, np.inf)
* noise of the sensors does not make an observer less sure
? sensing::the_filters_gain_tends_to_that_of_the_dual_riccati_equation
- residual @ covariance @ residual.T + gain @ noise @ gain.T
+ residual @ covariance @ residual.T
cranedyn/estimation/mpc.py
* an MPC optimises nothing where a swing is too large
? mpc::an_optimisation_that_fails_ends_the_run_and_no_old_command_goes_on
- if low.max() <= 0.0 <= high.min() and np.abs(offset).max() <= 1.0:
+ if low.max() <= 0.0 <= high.min():
cranedyn/dynamics/bodies.py
* positions of points are those along other axes
? validity::positions_of_points_in_many_rows_are_pinocchios
- return np.array(axes).T
+ return np.array(axes[::-1]).T
cranedyn/estimation/load_filter.py
* how sure an observer of the load is moves on to first order
? load_estimate::the_covariance_of_a_load_at_rest_goes_on_to_second_order_in_the_period
- self._identity + step + step @ step / 2.0
+ self._identity + step
* a reading of the cable says nothing of its share
? load_estimate::what_the_sensors_should_say_has_the_derivatives_that_differences_give
- slopes[encoder, _SHARE] = -values[encoder] / scale
+ slopes[encoder, _SHARE] = 0.0
cranedyn/estimation/load_estimate.py
* the rate of a longer cable does not move its motion
? load_estimate::rates_and_accelerations_of_a_cable_twice_as_long_are_how_its_motion_changes
- square_acceleration = d_acceleration * d + d_rate**2
+ square_acceleration = d_acceleration * d
cranedyn/controllers/lqr.py
* the Riccati sweep forgets the cost of effort on the way
? control::the_finite_horizon_tends_to_the_algebraic_riccati_equation
- effort_weight + input_cost @ b[k]
+ 0.5 * effort_weight + input_cost @ b[k]
cranedyn/references/flat.py
* a first compiled step imports what few runs need
? api::a_first_compiled_step_imports_little
- np.poly1d([70.0, -315.0, 540.0, -420.0, 126.0] + [0.0] * 5)
+ np.polynomial.Polynomial([0.0] * 5 + [126.0, -420.0, 540.0, -315.0, 70.0])
* a flat path takes the load for a point
? control::a_flat_slew_leaves_the_swing_that_the_documents_tell_of
- inertia = (crane.payload_inertia[0, 0] + sum(crane.dummy_inertia) / 2.0) / crane.payload_mass
+ inertia = 0.0
* half of the Coriolis term of a path
? flat::the_centre_of_oscillation_takes_the_path_and_the_rope_points_along_its_pull
- 2.0 * radius_way * gamma_way * speed**2
+ radius_way * gamma_way * speed**2
* a path leaves the inertia of its load out of the cable
? flat::the_centre_of_oscillation_takes_the_path_and_the_rope_points_along_its_pull
- length = (reach + np.sqrt(reach**2 - 4.0 * inertia)) / 2.0
+ length = reach
* a cruise never reaches its end
? flat::a_cruise_gains_its_speed_in_a_ramp_keeps_it_and_loses_it
- ramp / (duration - ramp) *
+ ramp / duration *
* a load may fall faster than gravity for a part of its way
? flat::a_load_that_would_fall_faster_than_gravity_or_hangs_on_no_cable_is_refused
- if rope[:, 2].min() <= 0.0:
+ if rope[:, 2].max() <= 0.0:
cranedyn/references/limits.py
* efforts need nothing
? limits::efforts_are_mass_times_acceleration_and_weight_whichever_way_a_drive_goes
- "effort": np.abs(motion_efforts
+ "effort": 0.0 * np.abs(motion_efforts
* rates are limited forward only
? limits::a_motion_uses_of_rate_and_acceleration_what_its_quintic_has
- np.abs(motion.v[:, layout.drives]).max(axis=0)
+ motion.v[:, layout.drives].max(axis=0)
* a share of a limit that is no number is passed over
? limits::efforts_that_overflow_are_no_efforts_within_limits
- if math.isnan(share):
+ if False:
* a limit may be negative
? limits::a_limit_that_is_not_finite_and_above_zero_is_refused
- number(f"{kind} limit", value, f"per {per}", "> 0")
+ number(f"{kind} limit", value, f"per {per}")
cranedyn/references/motion.py
* a hanging reference does not end at rest
? limits::a_hanging_reference_covers_its_duration_and_ends_at_rest
- samples[1:, -1] = 0.0
+ samples[1:, -1] *= 1.0
* friction of the drives pushes them
? limits::efforts_overcome_the_friction_of_the_drives
- forces[:, i] -= joint[i]
+ forces[:, i] += joint[i]
cranedyn/compiled/load_filter.py
* the compiled filter takes the load for twice as much when it is lighter
? load_filter::compiled_and_plain_filters_of_another_crane_take_the_same_step
- by[:, -1] * -(load / self.mean[-3])
+ by[:, -1] * -(load / (self.mean[-3] * self.mean[-3]))
* the derivatives of a compiled filter leave damping out
? load_filter::compiled_and_plain_filters_of_another_crane_take_the_same_step
- force = force - self._joint.effort(q, v)
+ force = force - self._joint.effort(q, 0.0 * v)
cranedyn/compiled/horizon/control.py
* what the drives did does not move the swing that is expected
? horizon::what_it_believes_of_the_swing_is_what_swings_where_sensors_are_exact
- done = (v[drives] - rates_before) / period
+ done = 0.0 * (v[drives] - rates_before)
* a plan for converters begins with the rates measured
? horizon::drives_twice_as_late_as_believed_leave_no_swing
- v[drives], self.programme.rate_share
+ v[drives], 1.0
* a predictive controller learns from what it did not read
? horizon::what_was_not_read_teaches_nothing_of_what_disturbs
- gain = learns * (programme.share / programme.period)
+ gain = programme.share / programme.period
* a planned hoist may let go of the load
? horizon::it_never_commands_a_slack_rope_however_fast_the_hoist_may_be[motion]
- acceleration[hoist] = code.chosen(over > 0.0, reduced, acceleration[hoist])
+ acceleration[hoist] = acceleration[hoist]
* what disturbs a drive is not taken off
? horizon::a_load_of_another_mass_ends_where_it_shall_since_what_disturbs_is_estimated
- crane.answer(q, v, acceleration - estimate, None)
+ crane.answer(q, v, acceleration, None)
cranedyn/compiled/horizon/memory.py
* what is the same in every stage is left out of the recursion
? horizon::along_a_motion_nothing_is_left_at_its_end
- return self._constants[name, row, i]
+ return 0.0
* a crane of a batch plans in the lane of another
? horizon::from_hard_starts_each_crane_of_a_batch_goes_where_it_goes_alone_in_any_lane
- return self._shape.cranes * (self._shape.place(name, row) + i)
+ return self._shape.cranes * self._shape.place(name, row) + i
cranedyn/plant/rigid_body.py
* a mass that is counted with a parent has no distance from its mass
? rigid_body::a_mass_on_the_axis_of_its_joint_is_counted_with_a_parent_that_has_its_own
- inertia[i] = inertia[i] - arm @ arm * (mass[i] * share)
+ inertia[i] = inertia[i] - arm @ arm * mass[i]
* accelerations never disagree
? rigid_body::a_difference_counts_from_its_round_off_on
- return 0.0 if off <= _AGREEMENT or off <= lost_digits(mass) else off
+ return 0.0
* a point moves about its joint the other way
? rigid_body::points_and_spins_of_a_body_are_those_of_pinocchio
- speed = speed + cross_product(spin, arm) + turn @
+ speed = speed - cross_product(spin, arm) + turn @
* the Coriolis term of the recursions has the wrong sign
? compiled::a_run_of_many_blocks_is_the_same
- sliding = 2.0 * (tree.rotation[i] @ (along * rate))
+ sliding = -2.0 * (tree.rotation[i] @ (along * rate))
* what hangs on its rope has no mass across it
? rigid_body::a_load_on_its_rope_moves_as_in_pinocchio_wherever_its_centre_is
- np.multiply.outer(moved, moved) * tree.mass[last]
+ np.multiply.outer(moved, moved) * 0.0
cranedyn/compiled/kernel.py
* an angle that turned too far for a series keeps what the series gave
? turned_angles::long_steps_that_turn_far_are_those_of_pinocchio
- self._set_angle(i, turn.refine(rotated[i]))
+ self._set_angle(i, rotated[i])
* the effort up to an instant counts the wind from it on
? compiled::both_engines_record_the_same
- return self._get("pushed")
+ return self._forces(instant)
* a compiled loop logs efforts a period late
? compiled::a_run_of_many_blocks_is_the_same
- acts = [*values.command, *values.effort, *values.before]
+ acts = [*values.command, *values.before, *values.effort]
* a compiled loop dissipates at the end of a period alone
? compiled::a_run_of_many_blocks_is_the_same
- loss = (self._get("power") + power) / 2.0 *
+ loss = power *
* a compiled loop counts the work of the effort before a period
? compiled::a_run_of_many_blocks_is_the_same
- work = (self._get("acted") + values.before) / 2.0 *
+ work = values.before *
* a compiled loop does not say that the model has ceased to hold
? compiled::a_hoist_that_pushes_the_rope_ends_both_runs
- code.chosen(values.holds, 0.0, 1.0), 2.0)
+ 0.0, 2.0)
* compiled code begins a piece of a control period with control again
? compiled_binding::a_run_in_pieces_is_the_same_to_the_bit
- with code.when(code.builder.not_(begun)):
+ with code.when(code.builder.or_(code.builder.not_(begun), begun)):
cranedyn/compiled/verify.py
* compiled cranes are taken as they come
? compiled::code_that_moves_otherwise_is_refused
- if off := rigid_body.disagreement(
+ if off := 0.0 * rigid_body.disagreement(
cranedyn/plant/plant.py
* compiled cranes have no joint damping
? compiled::a_run_of_many_blocks_is_the_same
- effort = self.joint.effort(q, v)
+ effort = 0.0 * v
* compiled forces act on the wrong body
? compiled::disturbances_that_are_no_forces_end_both_runs_in_the_same_words
- map(ExternalForce._make, acting)
+ (ExternalForce(min(body, 3), lever, force) for body, lever, force in acting)
* compiled buffers push outwards
? compiled::both_engines_record_the_same
- effort[drives] + self.stops.effort(q, v)
+ effort[drives] - self.stops.effort(q, v)
cranedyn/compiled/step.py
* compiled buffers do half of their work
? compiled::both_engines_record_the_same
- array([0.5 * dt * self.unit * done, 0.0])
+ array([0.25 * dt * self.unit * done, 0.0])
* compiled code forgets the work of the ground
? contact::both_engines_let_a_box_fall_tip_and_slide_alike
- works=after.works + array([work, 0.0])
+ works=after.works
* compiled RK4 gives way to small steps too late
? compiled::both_engines_record_the_same
- for q in (before.q, smooth.q):
+ for q in (before.q,):
cranedyn/compiled/engine.py
* a stepping rule that looks at numbers becomes code all the same
? compiled::a_stepping_rule_without_code_is_refused_before_anything_is_asked_whatever_its_name
- check_rule(setting.integrator)
+
* a diverged block is repeated instant by instant
? compiled::a_run_that_diverges_late_is_repeated_only_from_there
- ahead = self._rows_before_divergence(block)
+ ahead = 0
* what a compiled loop integrated is forgotten
? compiled::a_run_of_many_blocks_is_the_same
- if hasattr(controller, "resume"):
+ if False:
cranedyn/compiled/batch.py
* a batch keeps its tables to the end
? batch::starts_of_their_own_take_a_fifth_more_memory_than_equal_ones_at_most
- del loop, control, tables, forces, offsets
+ assert loop
* a row of forces holds for one control instant whatever its interval
? batch::each_crane_of_a_batch_does_what_it_does_alone
- force_interval=force_interval,
+ force_interval=1,
* cranes of a batch have each other's numbers
? batch::each_crane_of_a_batch_does_what_it_does_alone
- group_lanes([compiled.varied[compiled.index]], lanes)
+ group_lanes([compiled.varied[compiled.index[::-1]]], lanes)
* a swing of a batch counts as residual a row late
? batch::the_summary_is_that_of_the_recorded_rows
- math.ceil(periods - _ROUNDING)
+ math.ceil(periods - _ROUNDING) + 1
cranedyn/compiled/inputs.py
* drives that hold where they start all hold where the first one does
? batch::a_hold_controller_keeps_its_places_as_any_other_controller
- np.arange(cranes) % len(places)
+ np.arange(cranes) % 1
cranedyn/compiled/binding.py
* tables are read beyond their end
? compiled_binding::only_counts_within_the_arrays_are_bound
- final + length > total
+ final > total
* a log with a ledger has room for some of its rows
? compiled_binding::a_log_with_a_ledger_has_room_for_a_row_at_each_instant
- 1 if recipe.ledger else log_interval
+ log_interval
cranedyn/compiled/rows.py
* compiled columns are rounded in another order than NumPy's
? compiled_binding::compiled_columns_have_the_bits_of_numpy_and_are_all_there_are
- as group, code.as_written():
+ as group:
cranedyn/compiled/fleet.py
* cranes of a fleet have the effort limits of the first
? compiled_fleet::efforts_are_cut_to_the_limits_of_each_crane_as_in_simulate
- for crane in self.cranes])[kinds]
+ for crane in self.cranes])[0 * kinds]
cranedyn/model/springs.py
* a rope is as stiff at any length
? cranes::springs_push_down_their_energy_and_the_tangent_is_how_they_do
- effort[rope.stretch] - rope.stiffness * strain
+ effort[rope.stretch] - rope.stiffness * q[rope.stretch] / 10.0
* a rope that stretches does not pull at its drum
? cranes::springs_push_down_their_energy_and_the_tangent_is_how_they_do
- effort[rope.length] + 0.5 * rope.stiffness * strain * strain
+ effort[rope.length]
* a spring may push away from its rest
? layout::a_spring_that_is_none_is_refused
- number(f"spring stiffness of {name}", text, unit, ">= 0")
+ number(f"spring stiffness of {name}", text, unit)
cranedyn/dynamics/linearisation.py
* a deviation of a taut rope stays
? slack::a_taut_rope_that_does_not_stretch_is_a_rigid_one
- power[:, :, list(held)] = 0.0
+ power[:, :, []] = 0.0
* free modes forget the springs
? cranes::free_modes_are_normal_and_keep_their_amplitudes
- rest_stiffness(crane.model, data, crane.springs, q, crane.coupling)[block]
+ (rest_stiffness(crane.model, data, crane.springs, q) - crane.springs.tangent(q))[block]
cranedyn/model/load.py
* an elastic crane starts where its springs are slack
? cranes::a_crane_hangs_where_nothing_accelerates_and_its_energy_has_the_springs
- return replace(crane, start=start, assumptions=assumptions)
+ return crane
* the inertia of a motor is not in the model
? cranes::springs_push_down_their_energy_and_the_tangent_is_how_they_do
- model.armature = read_armature(robot, names)
+
cranedyn/model/layout.py
* every joint counts as driven
? dynamics::a_large_swing_has_the_period_of_the_elliptic_integral
- return self._indices([joint.passive for joint in self.joints])
+ return self._indices([False for joint in self.joints])
cranedyn/model/joints.py
* one joint may play two parts
? layout::roles_are_named_once_and_known
- if joint in roles:
+ if False:
* a joint that nothing drives may play a drive
? crane::a_tower_crane_is_one_by_what_its_joints_do_whatever_their_names
- and joint.driven != is_swing
+
cranedyn/planning/clearance.py
* the own mast is no obstacle
? clearance::the_hook_keeps_from_the_own_mast_by_the_way_between_them
- Field([*solids, *mast])
+ Field([*solids])
* a load may be in the slewing column
? coverage::a_load_keeps_from_the_crane_s_own_base_and_upper_structure
- if self._upper_gap(q) < margin:
+ if False:
* what slews above a load is left out of its margin where it is far
? coverage::no_margin_is_more_than_that_of_the_upper_structure_however_far_below_it
- if self._upper_gap(q) < margin:
+ if self._upper_gap(q) < self.site.distance:
* a rope that leans lifts its load no higher
? coverage::no_margin_is_more_than_that_of_the_upper_structure_however_far_below_it
- below_pivot = length * math.cos(radial) * math.cos(tangential)
+ below_pivot = 1.5 * length
* what slews below the trolley stands still
? coverage::a_load_keeps_from_the_crane_s_own_base_and_upper_structure
- relative = slew.inverse() * load
+ relative = load
* a load may be in the crane's own base
? coverage::a_load_keeps_from_the_crane_s_own_base_and_upper_structure
- mast.append((OWN_BASE, hull(self.site.base_corners)))
+ pass
* hoisting moves the load straight down though its rope leans
? clearance::hoisting_along_a_leaning_rope_moves_the_load_no_farther_than_said
- 2.0 * aside * across * hoisted
+ 0.0 * aside * across * hoisted
cranedyn/planning/ground_lift.py
* the hoist of a load that stands pulls its whole weight
? ground_lift::a_load_is_lifted_off_the_ground_moved_and_set_down_on_an_obstacle
- (weight - tension) * self.crane
+ 0.0 * self.crane
* lift-off at no speed
? ground_lift::a_load_is_lifted_off_the_ground_moved_and_set_down_on_an_obstacle
- -float(motion.v[rows, hoist][0]), omega
+ 0.0, omega
* lift-off is bounded off-lead, too
? ground_lift::a_load_that_is_lifted_off_lead_and_set_down_beside_its_goal_has_no_certificate
- if (run["phase"][:moving] == OFF_LEAD).any()
+ if False
* a lift from the ground is only sampled
? ground_lift::a_post_that_no_measured_row_meets_is_found_between_the_rows_and_in_the_load_itself
- not unproven and nearest.distance
+ nearest.distance
* a load that turns in its sling stays where it was
? ground_lift::a_load_that_turns_in_its_sling_is_where_no_proof_was
- (3.0 * lug + 2.0 * radius) * turned
+ 0.0 * turned
* the hook of a strange crane is never turned
? ground_lift::a_crane_of_a_strange_urdf_lifts_off_as_the_crane_of_this_project_does
- pin.SE3(hook.T, np.zeros(3))
+ pin.SE3.Identity()
* a load may swing on its way
? ground_lift::a_load_that_swings_in_its_motion_has_no_certificate
- bool(largest <= allowed and least_pull > 0.0)
+ bool(least_pull > 0.0)
* a load may be set down at any speed
? ground_lift::a_load_is_set_down_at_the_speed_of_the_rope_that_first_slackens_and_leaves_it_slack
- speed <= sink_rate and apart
+ apart
* a change of the hoisting acceleration makes no bounce
? ground_lift_bounds::no_bounce_of_an_undamped_rope_is_above_the_bound_and_some_come_near
- change = a + np.cumsum(np.abs(np.diff(a, prepend=0.0)))
+ change = np.abs(a)
* the controller does not see the sling
? ground_lift_bounds::the_load_is_seen_where_it_hangs_in_its_sling
- share = lug / (state.q[at("l")] + lug)
+ share = 0.0 * (state.q[at("l")] + lug)
* a load that hangs by half of its weight is steered as if it hung
? ground_lift_bounds::a_hoist_pulls_by_the_tension_until_the_load_hangs_and_its_swing_is_hidden
- hangs = tension > HANGING_TENSION_RATIO * weight
+ hangs = tension > 0.0 * weight
* a rope may be as long as the ground needs
? ground_lift::a_rope_that_is_too_short_for_the_ground_has_no_certificate
- bool(inside.all())
+ True
* a load that stands may have any shape
? ground_lift::a_load_that_stands_is_a_box
- if not share >= BOX_SHARE:
+ if False:
cranedyn/planning/support.py
* what reaches higher than the load's bottom is its support, too
? coverage::the_walls_of_what_a_load_stands_in_stay_in_the_proof
- if top <= bottom + CONTACT_TOLERANCE
+ if True
* what is far below a load that hangs is its support
? coverage::a_load_that_hangs_or_is_inside_of_a_box_stands_on_nothing
- if Field([(solid.name, hull(part))]).least(load) <= CONTACT_TOLERANCE
+ if True
* a load may stand in a mesh
? coverage::a_load_stands_on_convex_parts_below_it_and_no_mesh
- and not solid.parts
+ and False
* a load may sink into what it stands on
? ground_lift::a_load_that_sinks_into_its_support_has_no_certificate
- holds = holds and depth <= CONTACT_TOLERANCE
+ holds = holds and True
cranedyn/planning/standing.py
* a crane may stand in an obstacle
? coverage::the_mast_stands_in_no_solid
- inside.append(BodyAndObstacle(name, solid.name))
+ pass
* the base is no body
? coverage::the_base_that_is_entered_is_a_body_too
- if site.base is not None:
+ if False:
* a foot may stand on nothing
? coverage::a_foot_stands_on_the_ground_or_an_obstacle
- if not result.inside and not result.below:
+ if False:
* what touches the mast is in it
? coverage::a_solid_that_the_mast_touches_is_no_reason_to_refuse
- np.maximum(np.abs(offset) - TOUCHING, 0.0)
+ np.abs(offset)
cranedyn/planning/site.py
* the base turns with the jib
? coverage::the_base_that_is_entered_is_a_body_too
- return np.array(corners) @ self.turn
+ return np.array(corners)
* an obstacle may have the name of the ground
? coverage::no_obstacle_has_a_name_of_our_own
- if solid.name in RESERVED_NAMES:
+ if False:
cranedyn/planning/coverage.py
* a pair that no proof compares is no matter
? coverage::the_pairs_of_all_bodies_and_obstacles_are_counted_by_hand
- missing = sorted(required - covered)
+ missing = sorted(required - required)
* an obstacle is compared with one of its parts
? coverage::an_obstacle_counts_as_compared_only_with_all_of_its_parts
- if count >= part_counts[obstacle]
+ if count
cranedyn/planning/remeasure.py
* a second look sees the load of the plan
? coverage::a_plan_for_a_load_of_half_its_size_is_contradicted
- load = site.load
+ load = 0.5 * site.load
* a second look does not swing the load
? coverage::a_plan_without_its_envelope_of_swing_is_contradicted
- if swing == 0.0:
+ if True:
* a point in a solid is as far from it as from its surface
? coverage::points_are_as_far_from_a_box_as_by_hand_and_from_a_mesh_alike
- return np.where(inside, 0.0, distances)
+ return distances
cranedyn/planning/lift.py
* a crane may be another than its site enters
? lift::a_crane_that_is_not_the_one_that_its_site_enters_is_refused
- if name in arguments and float(arguments[name]) != float(value):
+ if False:
* a plain URDF may weigh another load than its site enters
? lift::a_plain_urdf_is_not_another_crane_than_its_site_enters
- if entered is not None and not math.isclose(float(entered), actual, rel_tol=1e-9):
+ if False:
* what a plain URDF has no argument for is left out in silence
? lift::a_plain_urdf_is_not_another_crane_than_its_site_enters
- if name not in _COMPARED_ARGUMENTS:
+ if False:
* a load that the hoist cannot hold is searched a way for
? lift::a_load_beyond_the_hoist_is_refused_with_both_masses
- if not load <= held:
+ if False:
cranedyn/planning/bodies.py
* a rope has no width
? clearance::rope_and_trolley_keep_from_a_post_beside_them_by_what_the_urdf_draws
- falls=float(np.ptp(drawn.block[:, :2], axis=0).max()) / 2.0
+ falls=1e-3 * float(np.ptp(drawn.block[:, :2], axis=0).max()) / 2.0
* a parked neighbour has no rope
? clearance::the_rope_of_a_parked_neighbour_is_in_the_way
- return [*shapes, rope]
+ return shapes
cranedyn/planning/proof.py
* a row that is no number is proven
? coverage::no_proof_holds_with_a_coordinate_that_is_none
- if not finite.all():
+ if False:
* a run is proven by the lesser half of its way
? proof::a_motion_that_rests_and_then_enters_a_wall_is_not_proven
- np.maximum(moved[middle] - moved[low]
+ np.minimum(moved[middle] - moved[low]
* a load goes on a straight line from row to row
? proof::between_two_rows_alike_a_load_may_have_been_thrown_as_far_as_it_can
- bend = _MAX_ACCELERATION * period**2 / 8.0
+ bend = 0.0 * period
cranedyn/sites/brakes.py
* the latency of the drives is twice what is told
? sites::wild_operators_keep_to_boxes_and_swing_with_half_of_the_messages_lost
- REACTION = CYCLE + DELAY + LAGS["slew"] + ROUNDING
+ REACTION = 0.5 * (DELAY + LAGS["slew"])
* brakes are taken for twice as strong
? sites::a_crane_stops_within_its_stopping_distance_and_no_rate_is_larger_than_that
- speed / (2.0 * deceleration)
+ speed / (4.0 * deceleration)
cranedyn/sites/bodies.py
* the rope is left out
? sites::every_corner_of_every_shape_lies_in_a_capsule
- return [*rope, load]
+ return [load]
cranedyn/sites/capsules.py
* capsules of a rope end at shares of its length
? sites::rope_and_load_of_a_box_lie_in_those_of_any_larger_box
- (low[-1] - high[-1]), longest) + length
+ (low[-1] - high[-1]), 0.02 * high[-1] * longest) + length
* the load of a neighbour does not swing
? sites::every_corner_of_every_shape_lies_in_a_capsule
- radius=capsule[14] + capsule[13] * cone * (depths[1] + capsule[14])
+ radius=capsule[14]
* a joint is not moved by those beyond it
? sites::no_sample_of_the_largest_proven_boxes_is_too_near_by_the_distances_of_coal
- along.append(h * (first + turned + 0.5 * h * lever))
+ along.append(0.3 * h * first)
cranedyn/sites/proof.py
* the middle of a box is taken for all of it
? sites::no_sample_of_the_largest_proven_boxes_is_too_near_by_the_distances_of_coal
- with code.when(build.not_(apart - total >= required))
+ with code.when(build.not_(apart >= required))
* cranes that are near to the required distance are not proven
? sites::boxes_of_cranes_a_centimetre_beyond_the_required_distance_are_proven
- code.either(build.not_(gap >= required), late)
+ code.either(build.not_(gap >= required), total < 0.05, late)
* the ends of a box may be no numbers
? proof::no_box_with_a_number_that_is_none_is_proven_apart_from_anything
- return proven & is_box(first_box) & is_box(second_box)
+ return proven & is_box(first_box)
* what is no number is no reason to look at a pair of capsules
? proof::compiled_comparisons_fail_for_numbers_that_are_none
- with code.when(build.not_(delta @ delta >= near * near)):
+ with code.when(delta @ delta < near * near):
* a capsule that is none is no nearer than the others
? proof::a_distance_of_capsules_that_are_none_is_no_number
- return np.where(np.isfinite(rows).all(axis=1), least, math.nan)
+ return least
cranedyn/sites/supervisor.py
* copies are granted what the first is
? sites::copies_of_a_site_run_as_alone_and_touch_where_nothing_is_proven
- return BoxGrant(copies, number, box,
+ return BoxGrant(copies, number, box[:1].repeat(len(box), 0),
* a crane that withdraws is not let pass where it wanted to go before
? sites::of_cranes_that_wait_for_each_other_one_withdraws_to_where_the_other_can_pass
- goes = self.passing[copies, station] < 0
+ goes = self.passing[copies, station] < 9
* a held box may leave the reserved one on one side
? supervisor::a_held_box_may_leave_the_reserved_one_on_neither_side
- is_reserved = (reserved[:, 0] <= held[:, 0]) & (
+ is_reserved = (reserved[:, 0] <= held[:, 0]) | (
* a wanted box need not contain the held one
? supervisor::a_wanted_box_contains_the_held_one_on_both_sides
- is_extended = (wanted[:, 0] <= held[:, 0]) & (held[:, 1] <= wanted[:, 1])
+ is_extended = (wanted[:, 0] <= held[:, 0]) | (held[:, 1] <= wanted[:, 1])
* more than a drive reaches may be wanted
? supervisor::a_wanted_box_lies_in_the_ranges_of_the_drives
- in_range = (lowest <= wanted[:, 0]) & (wanted[:, 1] <= highest)
+ in_range = lowest <= wanted[:, 0]
* the ends of a held box may be swapped
? supervisor::a_box_whose_ends_are_swapped_inside_of_the_reserved_one_is_no_held_box
- sound = (is_ordered & is_reserved & is_extended & in_range)
+ sound = (is_reserved & is_extended & in_range)
* one message may ask twice for one copy
? supervisor::of_two_rows_of_a_message_for_one_copy_the_first_counts
- counts = known & first_rows & sound & is_new
+ counts = known & sound & is_new
cranedyn/sites/plan.py
* a lift passes those that were planned before as if they were not there
? plan::planned_lifts_arrive_and_keep_the_distance_that_is_proven
- row = None if other == crane else
+ row = None if other >= 0 else
* the drives of a straight motion do not lead the load
? plan::a_lift_of_a_luffing_crane_leaves_no_swing_in_little_more_than_the_least_time
- curve = make_interp_spline(t, coordinates, k=5)
+ curve = make_interp_spline(t, plumb, k=5)
* a certificate puts lifts of one crane over each other
? plan::the_certificate_of_a_plan_fails_where_it_is_disturbed
- earliest = (len(before) - 1) * SLICE
+ earliest = 0.0
* a lift that nothing lets pass waits until all others are done
? plan::a_lift_for_which_no_crane_can_make_way_does_not_wait
- if boxes and all(self.others_can_stand_clear(crane, of_leg) for of_leg in boxes):
+ if boxes:
* no way around obstacles is looked for
? plan::a_lift_goes_around_obstacles_over_which_its_load_cannot_be_raised
- if site.solids and not any(
+ if not site.solids and not any(
* the operator of a plan is late by the lag of the drives
? simulate::the_operator_of_a_plan_leads_its_drives_by_their_delay_their_lag_and_half_a_cycle
- CYCLE / 2.0 + station.converters.lags
+ CYCLE / 2.0 - station.converters.lags
* a plan travels against gusts as if they blew on a load at rest
? working_wind::a_planned_load_travels_no_faster_than_gusts_against_it_allow
- against = (wind.gust + speed) ** 2 - wind.gust**2
+ against = 0.0 * speed
* a plan uses the swing that gusts need
? working_wind::the_wind_of_a_site_file_is_that_of_its_guards_and_plans
- return working_swing(site.stations[crane], site.swing, site.working_wind)
+ return site.swing
cranedyn/sites/simulate.py
* what bodies move between two rows is left out
? plan::bodies_that_pass_each_other_between_two_rows_are_told_from_those_that_meet
- if gap_low + gap_high - moved * (high - low) > 2.0 * bend:
+ if gap_low + gap_high > 2.0 * bend:
* a bound of a distance is taken for proven without the motion since
? sites::copies_of_a_site_run_as_alone_and_touch_where_nothing_is_proven
- distances = last_distances - np.cumsum(motion, axis=0)
+ distances = last_distances - np.cumsum(0.0 * motion, axis=0)
* bodies bulge by a tenth between two rows
? simulate::bodies_that_may_bulge_between_two_rows_by_thrice_a_fall_are_not_proven_apart
- _BEND = 32.0 * CYCLE**2 / 8.0
+ _BEND = 3.2 * CYCLE**2 / 8.0
* messages take no time
? simulate::a_box_grows_once_a_request_and_its_answer_have_arrived
- queue.append((t + self._channel.latency, station, sent))
+ queue.append((t, station, sent))
* states that are no numbers touch nothing
? simulate::states_that_are_no_numbers_count_as_a_contact
- np.argwhere(~(spare > 4.0 * _BEND))
+ np.argwhere(spare <= 4.0 * _BEND)
* a crane that was ahead of the others keeps its last row
? simulate::a_crane_that_was_ahead_of_one_that_ends_a_run_is_cut_to_whole_cycles
- trajectories.append(trajectory if len(trajectory.t) == rows else trajectory.before(end))
+ trajectories.append(trajectory)
* wind from the other side is never too strong
? working_wind::a_run_says_that_its_wind_is_outside_of_what_the_site_assumes
- rows = np.flatnonzero(~(np.abs(self.wind_speed) <= limit.gust))
+ rows = np.flatnonzero(~(self.wind_speed <= limit.gust))
* guards do not read the wind
? working_wind::guards_stop_the_work_above_the_entered_wind_and_go_on_below
- return float(self._anemometer(t))
+ return None
cranedyn/sites/working_wind.py
* a gust swings a load as far as it leans
? guard::a_guard_leaves_twice_the_lean_of_the_wind_to_gusts
- GUST_RESPONSE = 2.0
+ GUST_RESPONSE = 1.0
* a load leans by the wind and not by its square
? working_wind::a_gust_swings_a_load_to_twice_its_static_lean
- self.drag_ratio(crane) * self.gust**2
+ self.drag_ratio(crane) * self.gust
cranedyn/sites/start.py
* what is between the chords of a mast is not in it
? start::an_obstacle_where_a_part_of_a_crane_is_at_the_start_is_refused_by_name
- for corners in group_shapes(placed):
+ for corners in placed:
* a crane is turned the wrong way at its start
? start::parts_of_a_crane_are_where_its_heading_points
- append(points @ foot[:, :3].T + foot[:, 3])
+ append(points @ foot[:, :3] + foot[:, 3])
cranedyn/sites/assumptions.py
* what nobody entered counts as entered
? assumptions::what_is_left_out_of_a_site_file_is_a_default_in_the_list
- return Origin.ENTERED if value in station.entered else Origin.DEFAULT
+ return Origin.ENTERED
cranedyn/plotting/html.py
* a name is HTML
? html::a_name_is_text_wherever_it_stands_and_makes_no_element
- autoescape=True,
+ autoescape=False,
cranedyn/plotting/figures.py
* a name between dollar signs is a formula
? figures::a_name_is_drawn_as_it_is_wherever_it_stands
- text.set_parse_math(False)
+ pass
cranedyn/sites/page.py
* all that is commanded counts as lost
? plan::a_page_of_a_run_shows_where_cranes_touch_and_what_is_lost
- -rates, rates) - passed
+ -rates, rates)
cranedyn/sites/site.py
* only the middle of a box is drawn
? plan::a_run_is_recorded_with_each_crane_at_its_place_and_written_as_one_table
- boxes[:, :1] + share * np.diff(
+ boxes[:, :1] + 0.5 * np.diff(
* wind is turned the wrong way
? working_wind::wind_blows_loads_in_its_direction_on_a_site_whose_cranes_are_turned
- direction = self.direction - station.turn
+ direction = self.direction + station.turn
* a box that is none is clear where there is no doubt
? proof::no_box_with_swapped_ends_is_proven_apart_from_anything
- proven[~sound] = False
+ proven[~sound] &= True
* nothing is in the way of a crane at its start
? start::a_site_file_with_a_box_over_a_tower_is_refused_with_the_line_of_the_crane
- bodies = [solid for solid in self.solids if not solid.zone]
+ bodies = []
cranedyn/sites/obstacles.py
* the middle of a box is taken for all of it
? plan::a_supervised_crane_stops_before_an_obstacle_or_zone
- near = ~(margin >= placed.motion.sum(axis=1))
+ near = ~(margin >= 0.0)
* solids may be as near as zones
? proof::solids_are_kept_at_the_required_distance_and_zones_out_of
- np.minimum(margins[:, 0] - distance, margins[:, 1])
+ np.minimum(margins[:, 0], margins[:, 1])
* a capsule moves by its largest motion
? proof::an_obstacle_at_the_corner_of_a_box_is_found_though_no_single_drive_reaches_it
- placed.motion.sum(axis=1))
+ placed.motion.max(axis=1))
* a margin that is no number is one
? proof::a_capsule_that_is_none_has_no_margin
- return math.nan, math.nan
+ return math.inf, math.inf
cranedyn/sites/site_file.py
* weak gears leave the drives as they are
? plan::drives_with_weak_gears_ramp_no_faster_than_their_brakes_stop
- slopes = np.minimum(drives.accelerations, brake.decelerations)
+ slopes = drives.accelerations
cranedyn/recording/run.py
* cranes are drawn without their heading
? plan::a_run_is_recorded_with_each_crane_at_its_place_and_written_as_one_table
- return Rotation.from_euler("z", self.heading).apply(points)
+ return Rotation.from_euler("z", 0.0 * self.heading).apply(points)
* cranes are turned the other way
? scenery::a_crane_with_a_heading_is_turned_from_x_towards_y_about_its_foot
- return Rotation.from_euler("z", self.heading).apply(points)
+ return Rotation.from_euler("z", -self.heading).apply(points)
cranedyn/recording/scene.py
* an obstacle is red while the load is far
? scenery::an_obstacle_is_red_while_the_load_is_near_and_a_zone_is_transparent
- rgb(_NEAR_COLOUR if is_near else usual_colour)
+ rgb(usual_colour if is_near else _NEAR_COLOUR)
* boxes of a recording are twice as large
? scenery::shapes_are_as_large_as_in_the_urdf_and_turned_about_fixed_axes
- sizes=size,
+ half_sizes=size,
cranedyn/recording/series.py
* forces from outside are no numbers of a run
? scenery::forces_from_outside_are_numbers_of_a_run_that_has_them
- if trajectory.force.any() or trajectory.outside.any():
+ if False:
cranedyn/recording/record.py
* infinite numbers are recorded
? scenery::a_number_that_is_not_finite_is_recorded_by_nobody
- if not np.isfinite(values).all():
+ if np.isnan(values).any():
cranedyn/sites/guard.py
* no swing grows where the rope is hoisted
? sites::no_rope_swings_beyond_its_envelope_while_slow_drives_hoist_turn_and_slide
- return swing * growth
+ return swing
* a fault brakes more gently than the box allows
? sites::wild_operators_keep_to_boxes_and_swing_with_half_of_the_messages_lost
- held_change = _planned_decelerations(crane, inputs.box) * CYCLE
+ held_change = _planned_decelerations(crane, inputs.box) * CYCLE / 3
* turning and sliding at constant rates incline no rope
? sites::a_guard_counts_that_a_plumb_rope_swings_to_twice_what_turning_inclines_it_by
- / (EXTRAPOLATION_STEP * crane.gravity)
+ / (1e9 * crane.gravity)
* a late grant is taken for the last
? guard::a_grant_that_answers_an_older_request_is_ignored_though_its_box_would_do
- answers_last = (number == last_number)
+ answers_last = (number >= 0)
* what a drive does before it follows is left out
? sites::a_drive_that_still_goes_faster_than_commanded_is_slowed_down_more
- remaining = _maximum(distance - distance_on_the_way, 0.0)
+ remaining = distance
* a swing grows by the shortening of its rope
? guard::a_guard_leaves_room_for_a_swing_that_grows_by_the_power_1_5_of_the_shortening
- return ratio * square_root(ratio)
+ return ratio
* a guard takes more than it asked for
? guard::a_grant_that_no_sound_supervisor_gives_is_ignored
- above = (held[:, 1] <= box[:, 1]) & (box[:, 1] <= wanted[:, 1])
+ above = held[:, 1] <= box[:, 1]
* a grant of no numbers is taken
? guard::a_grant_with_a_number_that_is_none_is_ignored_and_the_next_is_taken
- taken = answers_last & self._is_sound(copies, box, target)
+ taken = answers_last
* a crane withdraws to any place
? guard::a_crane_withdraws_to_no_place_out_of_its_ranges
- (in_range.all(axis=1) | stays.all(axis=1))
+ (stays | ~stays).all(axis=1)
* a wind that is no number is none
? guard::a_guard_stops_work_above_its_wind_and_goes_on_below
- too_windy = ~(np.abs(speed) <= self._wind.gust)
+ too_windy = np.abs(speed) > self._wind.gust
* work goes on in any wind
? guard::a_guard_that_was_told_of_no_wind_stops_in_any
- works = plausible & ~self.stopped_by_wind
+ works = plausible
* no air is met by a load that travels
? guard::a_load_that_travels_against_the_wind_leaves_it_more_room
- air_speed = crane.gust + sum(
+ air_speed = crane.gust + 0.0 * sum(
* only what was commanded swings a rope
? guard::the_larger_of_measured_and_commanded_rates_counts
- speed = _maximum(abs(rates), abs(velocity))
+ speed = abs(rates)
* two drives in one direction are at right angles
? guard::drives_that_push_a_pivot_in_one_direction_add_up
- return bool((products <= RIGHT_ANGLE_TOLERANCE
+ return bool((products <= 1e9
cranedyn/planning/timing.py
* a way is timed to the end whatever is shorter
? lift::a_way_that_takes_longer_than_another_is_given_up
- longest = within if best is None
+ longest = math.inf if best is None
* an average that is too long with its first law ends the search for a motion
? lift::a_way_that_takes_longer_than_another_is_given_up
- _TOO_LONG = 1.12
+ _TOO_LONG = 0.5
cranedyn/planning/perturbed.py
* a lift that broke off is not counted as such
? lift::a_lift_that_failed_counts_as_one_that_came_too_near
- np.count_nonzero(np.isnan(self.least))
+ np.count_nonzero(np.isinf(self.least))
* lifts with other delays run at once
? lift::lifts_that_run_at_once_share_load_and_delay_and_none_is_lost
- kinds = np.stack([drawn["load"], drawn["late_s"]])
+ kinds = np.stack([drawn["load"], drawn["load"]])
* perturbed lifts jump from row to row
? lift::a_lift_that_passes_a_plate_between_two_rows_kept_is_near_to_it
- margin - np.abs(moved - moved[k]) - step
+ margin - np.abs(moved - moved[k])
* a distance measured in one row holds in all
? lift::rows_beside_a_measured_one_are_bounded_by_the_way_to_them
- margin - np.abs(moved - moved[k])
+ margin - 0.0 * np.abs(moved - moved[k])
* a load that hangs in the wind leans against it
? lift::the_wind_at_the_start_leans_the_load_to_its_lee_and_meets_its_broad_side
- start[:, joints.tangential_swing] = -np.arctan2(
+ start[:, joints.tangential_swing] = np.arctan2(
cranedyn/lifting/wind_limit.py
* a lift that left the chart is as good as at its end
? wind_limit::a_lift_that_left_the_chart_uses_a_million_times_of_it
- np.where(inside == radius, used, _FAILED).max(axis=1)
+ used.max(axis=1)
* a lift whose model ended early counts as one that held
? wind_limit::a_lift_that_failed_stays_as_it_was_and_the_others_are_counted
- & ~np.isfinite(batch.valid_until)
+ & True
* a load may come as near as it will in a gust
? wind_limit::gusts_are_drawn_over_the_whole_lift_from_every_side_and_limits_are_the_sites
- "clearance": certificate.lift.clearance.site.distance
+ "clearance": 0.0
* a lift that is no number keeps a limit
? wind_limit::at_each_speed_the_worst_of_all_lifts_counts
- np.min if name == "clearance" else np.max
+ np.nanmin if name == "clearance" else np.nanmax
* the mean wind is as strong as the gust
? judgement::the_wind_limit_is_that_of_the_worst_gust_whatever_is_drawn
- "wind_m_s": speed / GUST_FACTOR
+ "wind_m_s": speed / 1.0
cranedyn/planning/drive_trajectory.py
* drives of a plan reach no farther than at their rates at both ends
? least_time::drives_reach_no_farther_between_two_times_than_is_said
- self._rate(np.concatenate([[first, last], between]))
+ self._rate(np.array([first, last]))
cranedyn/planning/optimal.py
* a rope may lean as it will between the points of a plan
? least_time::a_motion_whose_rope_leans_more_than_the_site_allows_is_not_returned
- if tilt.max() > clearance.site.swing:
+ if False:
cranedyn/planning/curve.py
* a lift of years is planned until the memory is full
? lift::a_motion_of_hours_is_refused_and_one_of_minutes_is_not
- if not duration <= LONGEST_LIFT:
+ if duration > 1e300:
* a path takes its corners at the rates of its legs
? proof::before_a_corner_a_path_already_reaches_the_next_way_and_after_it_still_the_last
- begins = self.knots[:-1] - np.append(0.0, self.widths)
+ begins = self.knots[:-1]
cranedyn/lifting/chart.py
* a chart is a straight line of loads
? chart::between_its_points_the_moment_is_a_straight_line
- np.interp(radius, self.radii, self.radii * self.rated)
+ radius * np.interp(radius, self.radii, self.rated)
* a chart is read three metres short
? chart::utilisation_is_that_of_a_chart_by_hand
- .at(loads["radius_m"]))
+ .at(loads["radius_m"] - 3.0))
* what pulls aside counts against the chart
? chart::a_load_that_swings_takes_of_the_chart_what_pulls_down
- finite("pull of what hangs", loads["pull_N"]
+ finite("pull of what hangs", loads["rope_N"]
* a radius that is no number is within a chart
? not_finite::a_chart_answers_within_its_radii_and_nowhere_else
- outside = ~((radius >= self.least) & (radius <= self.radii[-1]))
+ outside = (radius < self.least) | (radius > self.radii[-1])
cranedyn/lifting/loads.py
* a buffer takes none of the tension of the rope
? loads::a_rope_pulls_what_hangs_on_it_where_a_buffer_takes_of_it_or_adds_to_it
- hoist + (cable_buffers(crane, moving.q, moving.v) if buffers else 0.0)
+ hoist + 0.0
* a rope leads to the other side
? loads::a_rope_that_leads_aside_pulls_by_its_tangent_and_twists_the_tower
- np.arctan2(_along(rope, aside), -rope[:, 2])
+ -np.arctan2(_along(rope, aside), -rope[:, 2])
* the tower stands on its corners mirrored
? loads::corners_carry_the_whole_and_turn_with_the_jib
- (m_y * x - m_x * y)
+ (m_y * x + m_x * y)
* a jib bends as if the load were behind a place
? loads::the_jib_bends_by_the_load_ahead_of_each_place_and_not_behind_the_trolley
- tilting[:, None] + down[:, None] * ahead
+ tilting[:, None] - down[:, None] * ahead
* a jib is not bent by the moment at the trolley
? loads::all_loads_of_a_crane_that_moves_in_the_wind_are_what_pinocchio_says
- tilting[:, None] + down[:, None] * ahead
+ 0.0 * tilting[:, None] + down[:, None] * ahead
* corners change places
? loads::each_corner_presses_as_by_hand
- [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]
+ [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)]
* both moments tilt the base the other way
? loads::corners_balance_force_and_moment_of_any_direction
- (m_y * x - m_x * y)
+ (m_x * y - m_y * x)
* wind is no load of a run
? loads::all_loads_of_a_crane_that_moves_in_the_wind_are_what_pinocchio_says
- crane, run.q, run.v, run.effort, run.force, base=base
+ crane, run.q, run.v, run.effort, None, base=base
* a load that overflows is a load
? not_finite::loads_of_impossible_rows_are_refused_or_finite
- finite(name, values, ("rows",)).reshape(shape)
+ values.reshape(shape)
cranedyn/lifting/wind.py
* a gust leans a load as far as a steady wind
? factors::a_load_leans_by_the_balance_of_moments_and_in_a_sudden_wind_by_that_of_work
- return 2.0 * wind_lean(force, mass, gravity)
+ return wind_lean(force, mass, gravity)
cranedyn/lifting/factors.py
* a load let go slowly bounces as one let go at once
? factors::phi_3_is_the_least_tension_of_a_hoist_that_loses_a_part_of_its_load
- (1.0 + within("beta", beta, 0.0, 1.0))
+ (2.0 * within("beta", beta, 0.0, 1.0))
cranedyn/lifting/wrench.py
* the ground forgets where the crane pulls at it
? loads::what_passes_through_a_joint_is_what_pinocchio_says
- Wrench(force, moment, self.origin(joint))
+ Wrench(force, moment, 0.0 * self.origin(joint))
* a joint forgets that what hangs beyond it is accelerated
? chart::a_load_at_rest_takes_its_share_and_one_that_is_lifted_faster_more
- transmitted = rigid_body.transmitted(tree, frames, rows(v), caused, forces)
+ transmitted = rigid_body.transmitted(tree, frames, rows(v), 0.0 * caused, forces)
cranedyn/planning/solids.py
* inside of a hollow mesh a body touches nothing
? start::an_obstacle_where_a_part_of_a_crane_is_at_the_start_is_refused_by_name
- return self.holds(corners[0])
+ return False
* a convex body that meets a part of an obstacle does not meet it
? coverage::the_mast_stands_in_no_solid
- if coal.collide(shape, here, geometry, here, request, result):
+ if False:
cranedyn/planning/plausibility.py
* what cannot be meant is only unusual
? plausibility::a_value_is_usual_unusual_or_refused_and_never_none_of_these
- refused = not possible[0] <= value <= possible[1]
+ refused = False and not possible[0] <= value <= possible[1]
* a number that is none is usual
? plausibility::a_value_is_usual_unusual_or_refused_and_never_none_of_these
- if low <= value <= high: return
+ if not (value < low or value > high): return
* obstacles in another unit vanish
? plausibility::an_obstacle_in_another_unit_does_not_vanish
- if gap > FAR_BEYOND * largest_radius:
+ if False:
* the volume of a load is one of its sides
? plausibility::no_value_of_an_example_is_unusual
- volume = float(sides.prod())
+ volume = 1e-3 * float(sides.max())
* places are judged in the frame of the site
? plausibility::a_place_is_as_far_as_it_is_from_the_foot_of_the_crane
- radius = _distance_in_plan(site.foot, point)
+ radius = _distance_in_plan(np.zeros(3), point)
cranedyn/lifting/judged_inputs.py
* every tower crane is judged by the shipped chart
? judgement::the_shipped_chart_is_of_the_shipped_crane
- and arguments.keys() <= CHART_COVERS
+
* a gust that nobody entered counts as entered
? judgement::each_value_that_nobody_entered_is_a_default
- self._assumption(self.default, Origin.DEFAULT, self.field)
+ self._assumption(self.default, Origin.ENTERED, self.field)
* the site's value comes before the caller's
? judgement::each_value_that_nobody_entered_is_a_default
- if given is not None: return given, self
+ if given is not None and of_site is None: return given, self
cranedyn/lifting/checks.py
* a counter-jib that is drawn too short is as long as entered
? judgement::the_counter_jib_of_a_plain_urdf_is_compared_with_the_one_entered
- drawn >= length - COUNTER_JIB_TOLERANCE,
+ True,
* checks may be left out of a GO
? judgement::a_check_of_ones_own_is_one_function
- if left_out:
+ if False:
* ground need not bear the tolerance of a load
? judgement::a_ground_bears_a_load_that_is_heavier_by_its_tolerance
- added * (0.25 + tilting)
+ 0.0 * added * tilting
* a lift is judged in any gravity
? judgement::a_lift_in_another_gravity_is_not_judged
- if EARTH[0] <= gravity <= EARTH[1]:
+ if True:
* a wind that was not computed is borne
? judgement::what_was_not_computed_or_entered_is_not_judged_and_no_go
- return Check(f"The wind limit was not computed: {reason}.", None)
+ return Check(f"The wind limit was not computed: {reason}.", True)
* perturbed lifts that were not simulated are harmless
? judgement::what_was_not_computed_or_entered_is_not_judged_and_no_go
- return Check(f"No perturbed lifts were simulated: {reason}.", None)
+ return Check(f"No perturbed lifts were simulated: {reason}.", True)
* ground bears what nobody entered
? judgement::what_was_not_computed_or_entered_is_not_judged_and_no_go
- None if smallest > 0.0 else False
+ smallest > 0.0
* a wind beyond the strongest that was tried is not borne
? judgement::what_was_not_computed_or_entered_is_not_judged_and_no_go
- if not holds and broken == math.inf:
+ if False:
* a lift from the ground is judged as one that hangs
? judgement::what_was_not_computed_or_entered_is_not_judged_and_no_go
- if not (stands_at(site.start) or stands_at(site.goal)):
+ if True:
* a lift may go with drives that nobody entered
? judgement::what_nobody_entered_is_not_judged_and_no_go
- missing; assumed: {rates}.", None)
+ missing; assumed: {rates}.", True)
* a rope may be slack where the hoist is strong
? judgement::a_lift_that_holds_goes_and_each_thing_that_does_not_stops_it
- slack > 0.0 and snag > 0.0
+ slack > 0.0 or snag > 0.0
* few lifts prove a risk as well as many
? judgement::too_few_lifts_prove_no_risk_though_none_came_too_near
- high <= required.risk
+ _ <= required.risk
* a load is as heavy as entered
? judgement::a_lift_that_holds_goes_and_each_thing_that_does_not_stops_it
- utilisation = (1.0 + spread) * float(analysis.utilisation.max())
+ utilisation = float(analysis.utilisation.max())
* a wind is borne up to the weakest gust that is not
? judgement::a_wind_is_borne_and_a_ground_bears_up_to_what_was_found_and_no_further
- limit >= required.wind
+ broken >= required.wind
cranedyn/data/bounded.py
* a binary file of any size is read
? logs::memory_time_and_size_are_bounded
- if file.seek(0, os.SEEK_END) > LARGEST_FILE:
+ if False:
cranedyn/data/reading_process.py
* a reader of a file may take any time
? logs::memory_time_and_size_are_bounded
- timeout=WALL_TIME,
+ timeout=None,
cranedyn/data/binary_reader.py
* a reader of a binary file may take all memory
? logs::memory_time_and_size_are_bounded
- resource.RLIMIT_AS: memory,
+ resource.RLIMIT_AS: resource.RLIM_INFINITY,
* links to other files are followed
? logs::data_of_hdf5_in_other_files_are_not_opened
- if not isinstance(group.get(key, getlink=True), h5py.HardLink):
+ if False:
* data sets that lie in other files are read
? logs::data_of_hdf5_in_other_files_are_not_opened
- if item.is_virtual or item.external:
+ if False:
* a view of a database is read, which may call functions
? mcap::a_database_whose_tables_are_views_is_refused
- kinds.get("topics") != "table" or kinds
+ kinds
cranedyn/data/external.py
* a unit that a file says is overlooked
? logs::a_unit_that_the_file_says_and_the_user_does_not_is_refused
- if factors.get(known_unit) == _factor(column, source.unit):
+ if True:
* what lies outside of since and until is judged
? logs::nothing_outside_of_since_and_until_is_judged
- rows = _rows_between(table, since, until)
+ rows = _rows_between(table, -math.inf, math.inf)
* a swing may be missing for any time
? logs::a_swing_that_is_missing_for_long_is_refused
- longest > allowed:
+ longest > 1e9 * usual:
* a topic holds its next value
? logs::a_topic_holds_its_value_until_its_next_one
- np.arange(len(values)), side="right") - 1
+ np.arange(len(values)), side="right")
cranedyn/data/text_layout.py
* a comma of thousands is taken for a decimal mark
? text_layout::an_ambiguous_table_is_refused
- if with_comma and all(
+ if False and all(
* of two delimiters that fit one is guessed
? text_layout::an_ambiguous_table_is_refused
- if len(delimiters) > 1:
+ if False:
* names of a table whose rows begin with a number are shifted
? text_layout::an_ambiguous_table_is_refused
- and len(cells) > 1 and ends_empty:
+ and len(cells) > 1:
* a header of another number of names is passed over
? text_layout::an_ambiguous_table_is_refused
- if last.is_comment:
+ if True:
cranedyn/data/clock_times.py
* a clock falls back at midnight
? clock_times::times_are_seconds
- seconds[present[1:]] += _DAY * midnights
+ pass
* a time zone is overlooked
? clock_times::times_are_seconds
- 3600.0 * hour + 60.0 * minute + second - offset
+ 3600.0 * hour + 60.0 * minute + second
cranedyn/data/logs.py
* times are read as numbers
? logs::times_are_no_angles
- if index in clocks and not may_be_time:
+ if False:
cranedyn/bridges/bags.py
* a folder is left by its links
? mcap::a_folder_that_is_no_recording_is_a_sentence
- entry.is_file() and not entry.is_symlink()
+ entry.is_file()
experiments/measured/sources.py
* git runs what a clone configures
? measured::programs_that_a_clone_names_do_not_run
- env=environment,
+ env={**os.environ, "GIT_DIR": str(clone.resolve() / ".git")},
cranedyn/identification/period.py
* a rate has the spectrum of its angle
? period::the_period_of_a_swing_or_its_rate_is_that_of_its_spectrum
- power[1:] /= frequencies[1:] ** 2
+ pass
* a period is told of less than two
? period::no_period_is_told_where_none_dominates_or_too_little_was_recorded
- if total <= 0.0 or not LEAST_PERIODS <= peak < len(power) - 1:
+ if total <= 0.0 or not 1 <= peak < len(power) - 1:
cranedyn/identification/problem.py
* a sign that was stated is tried otherwise
? assumed::a_stated_sign_is_not_tried_otherwise
- if column not in columns and column not in self.stated_signs:
+ if column not in columns:
cranedyn/identification/assumed.py
* what was stated counts as assumed
? assumed::what_was_stated_is_not_assumed
- is_known = name in prior.values or name in estimated
+ is_known = name in estimated
cranedyn/identification/estimate.py
* a swing is turned without a word
? assumed::a_swing_of_the_other_sign_is_a_decision_with_both_likelihoods
- signs=_sign_decisions(results, best)
+ signs=()
* errors with a memory count as if they had none
? estimate::coloured_errors_widen_the_intervals_and_never_narrow_them
- covariance += (1.0 - lag / (max_lag + 1.0)) * (cross + cross.T)
+ covariance += 0.0 * (cross + cross.T)
* intervals are left open on one side
? preflight::margins_foretold_are_those_that_come_out
- student.ppf(0.5 + CONFIDENCE / 2.0
+ student.ppf(CONFIDENCE
* noise of a record is taken for its second differences
? preflight::margins_foretold_are_those_that_come_out
- np.mean(differences**2, axis=1) / 6.0
+ np.mean(differences**2, axis=1) / 1.0
* errors of smoothed motions are not in the intervals
? estimate::the_rounding_of_a_cable_at_two_lengths_is_in_the_interval_of_its_offset
- return covariance + _motion_covariance(
+ return covariance + 0.0 * _motion_covariance(
cranedyn/identification/sampling.py
* repeats of a coarse encoder count as stale
? sampling::the_step_of_a_grid_is_found_whatever_share_of_its_rows_repeats
- coarse = np.abs(np.diff(values[fresh])) < 1.5 * resolution
+ coarse = np.abs(np.diff(values[fresh])) < 0.0
* a computed ramp counts as rounded
? sampling::exact_values_lie_on_no_grid_and_a_computed_ramp_on_one_of_its_making
- if not is_rounded(values, resolution):
+ if False:
* noise of a position counts as motion
? sampling::noise_of_a_position_is_told_from_its_motion
- noise=0.0 if irregular else white_noise(values)
+ noise=0.0
* a smoothed motion creeps less than it does
? sampling::a_curve_creeps_ahead_of_a_drive_that_starts_at_once
- return peak / (3.0 * self.cutoff)
+ return peak / (30.0 * self.cutoff)
* noise that is left in an acceleration goes with another power of the cutoff
? sampling::noise_is_left_in_an_acceleration_as_its_spectrum_says
- density * math.pi / 18.0 * self.cutoff**5
+ density * math.pi / 18.0 * self.cutoff**4
* a motion is measured again on the same grid
? sampling::a_smoothed_encoder_has_rate_and_acceleration_of_the_drive
- values = step * (np.rint(values / step - shift) + shift)
+ values = step * np.rint(values / step)
cranedyn/identification/parameters.py
* a gyroscope's swing begins on the other side
? parameters::a_swing_begins_where_its_angle_or_its_rate_says
- position = -slope * (record.swing_period
+ position = slope * (record.swing_period
* a delay is bounded by the slowest swing
? parameters::a_delay_and_half_a_window_are_less_than_a_quarter_of_the_fastest_swing
- quarter = 0.25 * min(
+ quarter = 0.25 * max(
cranedyn/identification/record.py
* a crane that cannot swing so is identified
? period::a_crane_that_cannot_swing_in_the_period_of_a_record_is_refused_with_its_inertias
- if own < possible.shortest / _IMPOSSIBLE_RATIO:
+ if False:
* a record is judged by the period of the crane that is believed in
? period::a_record_is_long_enough_by_its_own_period
- return self.recorded_period or self.swing_period
+ return self.swing_period
* a gap of a tenth of a period is a fault of a fast clock
? record::missing_rows_are_allowed_within_a_tenth_of_a_period
- max(_MAX_GAP_STEPS * np.median(steps), _MAX_GAP_SHARE * period)
+ _MAX_GAP_STEPS * np.median(steps)
* steps of an encoder are differentiated as they are
? estimate::the_mass_that_hangs_is_found_from_positions_in_steps_of_10_mm
- return sampled.is_held or is_irregular(t) or not sampled.is_exact(order)
+ return sampled.is_held or is_irregular(t)
* a record goes on beyond its end
? record::times_count_from_the_first_row_that_is_looked_at
- mask = (t >= since - 1e-9) & (t <= until + 1e-9)
+ mask = t >= since - 1e-9
* an encoder that slips is not told
? sampling::a_position_that_is_no_smooth_motion_is_said
- curve.acceleration_noise > _NOTABLE_NOISE:
+ curve.acceleration_noise > 1e9:
cranedyn/identification/model.py
* a gyroscope does not drift
? phone::cable_damping_and_gravity_of_a_gyroscope_lie_within_their_intervals
- rate + bias + drift * self.t
+ rate + bias
* rows in which it is open whether a drive stands count for its friction
? estimate::the_mass_that_hangs_is_found_from_positions_in_steps_of_10_mm
- effort_at_rows[:, undecided] = recorded_at_rows[undecided]
+ pass
* a smoothed motion has dry friction while it creeps
? estimate::the_mass_that_hangs_is_found_from_positions_in_steps_of_10_mm
- return np.where(np.abs(rate) > curve.creep, np.sign(rate), 0.0)
+ return np.sign(rate)
* a swing averaged over a window is that in its middle
? sampling::a_sensor_that_averages_is_told_from_one_that_is_late
- swing = (last_integral - first_integral) / window[:, None]
+ swing, _ = self._interpolate(angle, rate, delay + 0.5 * window)
cranedyn/identification/phone.py
* a phone lies along the swing
? phone::apps_differ_in_their_columns_only
- np.linalg.svd(rates - rates.mean(axis=0), full_matrices=False)[2][0]
+ np.array([1.0, 0.0, 0.0])
cranedyn/model/swing.py
* a hoist starts at the end of its range where its file has it
? foreign::a_hoist_that_its_file_starts_at_an_end_of_its_range_holds_a_swinging_load
- repr(min(max(start, low + margin), high - margin))
+ repr(start)
experiments/measured/effects.py
* a record agrees as far as it is uncertain itself, whatever it shares with the mean
? measured::records_agree_with_their_mean_within_the_interval_of_the_difference
- np.diag(deviation @ self.covariance @ deviation.T)
+ np.diag(self.covariance)
* gravity is as sure as its records are, though they differ by more
? measured::gravity_of_all_records_is_that_of_one_offset
- np.sqrt(beyond * variance[0, 0])
+ np.sqrt(variance[0, 0])
* a rail does not tilt
? measured::drag_centring_and_tilt_are_found_in_a_record_that_has_them
- bias + tilt * self._distance[i]
+ bias
experiments/measured/drive.py
* friction at rest is that in motion
? measured::stribecks_friction_is_told_from_dry_friction
- (dry + surplus * np.exp(-np.abs(v) / STRIBECK_RATE))
+ (dry + surplus)
cranedyn/model/machines.py
* what a source states is lost beside what is assumed
? machines::a_machine_swings_at_the_period_and_the_damping_of_its_numbers
- values=values | content["assumed"],
+ values=content["assumed"],
cranedyn/identification/preflight.py
* how a record begins counts as known before it is made
? preflight::margins_foretold_are_those_that_come_out
- total += full[:count, :count] - by_initial @ initial_inverse @ full[count:, :count]
+ total += full[:count, :count]
cranedyn/sweep/folder.py
* a chunk file of a sweep may stand for another
? sweep_integrity::a_part_that_stands_for_another_counts_as_not_done
- if label != self._label(index):
+ if False:
* a sweep goes on with other code
? sweep_integrity::a_study_edited_between_two_runs_is_not_mixed_in
- first.sources.items() ^ now.sources.items()
+ first.sources.items() ^ first.sources.items()
* a damaged chunk file of a sweep counts as done
? sweep_integrity::a_damaged_part_is_named_and_computed_again
- if not is_whole(content):
+ if False:
cranedyn/recording/viewer.py
* without a display nobody reads which file a browser shows
? viewer::without_a_display_the_viewer_points_to_serving_the_file
- check_display(*files)
+ check_display()
cranedyn/recording/shapes.py
* a mesh may lie anywhere
? meshes::a_mesh_that_cannot_be_drawn_is_refused
- if not path.is_relative_to(folder.resolve()):
+ if False:
cranedyn/bridges/task.py
* the drives of an environment brake as if periods had no length
? gymnasium::drives_keep_their_limits_and_stop_before_the_ends_of_their_ranges
- half = 0.5 * max_change
+ half = 0.0 * max_change
cranedyn/bridges/gymnasium.py
* an environment whose episode has ended shows how the old one ended
? gymnasium::next_step_and_same_step_are_followed_by_the_next_episode_as_gymnasium_says
- observations[ended] = self.task.observe(ended)
+
cranedyn/bridges/ros2.py
* a package of ROS leaves out what it needs
? ros2::the_package_depends_on_what_its_launch_files_use
- for dependency in DEPENDENCIES:
+ for dependency in DEPENDENCIES[1:]:
* a package of ROS leaves out the packages of its meshes
? ros2::the_package_depends_on_the_packages_whose_meshes_it_keeps
- for dependency in mesh_packages:
+ for dependency in []:
* a package of ROS hides that of its meshes
? ros2::a_package_that_would_hide_that_of_its_meshes_is_refused
- if name in mesh_packages:
+ if False:
* gravity of the world of gz sim is fixed
? ros2::the_worlds_have_the_gravity_of_the_crane
- f"0 0 {-crane.gravity!r}"
+ "0 0 -9.8"
* the first command in ROS is no effort at all
? ros2::the_efforts_before_the_first_command_hold_the_crane_where_it_starts
- states["effort"] = joint.holding
+ states["effort"] = 0.0
cranedyn/model/joints.py
* a chain of hundreds of joints takes all memory
? crane::a_chain_of_joints_that_would_take_all_memory_is_refused
- if count > MAX_MOVING_JOINTS:
+ if count > 898:
+         raise ModelError("too many")
+     if False:
cranedyn/model/sdf_frames.py
* roll and yaw of SDF are exchanged
? sdf::random_trees_move_for_two_seconds_as_in_dart
- rotation = pin.rpy.rpyToMatrix(angles)
+ rotation = pin.rpy.rpyToMatrix(angles[::-1])
* a placement_frame of SDF moves nothing
? sdf::the_pose_of_a_model_is_that_of_its_placement_frame
- return placement * in_model.inverse()
+ return placement
cranedyn/model/sdf.py
* axes of SDF 1.4 are taken in the joint frame
? sdf::an_axis_is_written_in_the_model_frame_up_to_1_4_and_in_its_joint_after_that
- elif in_model or self.version < JOINT_FRAME_AXES_VERSION:
+ elif in_model:
* a link of SDF without gravity falls all the same
? sdf::what_no_crane_has_is_refused_by_name
- if not is_true(child_text(link.element, "gravity", "true")):
+ if False:
* a misspelt element of SDF is lost
? sdf::what_no_crane_has_is_refused_by_name
- if child.tag not in known:
+ if child.tag == "":
* whatever names a joint in SDF drives it
? sdf::a_crane_of_gz_sim_is_read_with_its_limits_drives_springs_and_looks
- if not _DRIVING_PLUGIN.search(name):
+ if False:
* bodies of SDF that nothing holds are fixed to the ground
? sdf::what_no_crane_has_is_refused_by_name
- if count > 1:
+ if False:
* a second model of SDF is taken as a part of the first
? sdf::models_without_a_joint_between_them_are_refused_by_name
- if apart:
+ if False:
cranedyn/bridges/mjcf.py
* MuJoCo turns about the moving axes
? mjcf::a_turned_box_has_the_size_and_the_axes_of_the_urdf
- eulerseq="XYZ"
+ eulerseq="xyz"
* the keyframe of MuJoCo lets go of the load
? mjcf::a_crane_hangs_still_from_its_keyframe_on
- repr(joint.holding) for joint in moving
+ repr(0.0 * joint.holding) for joint in moving
* a turned inertia is turned the wrong way for MuJoCo
? mjcf::springs_motors_and_turned_inertias_are_carried
- tensor = turn @ tensor @ turn.T
+ tensor = turn.T @ tensor @ turn
* a rope pushes in MuJoCo
? mjcf::a_rope_that_stretches_pulls_as_here_and_pushes_as_little
- springlength=f"{-SLACK_LENGTH!r} 0"
+ springlength="0"
* the joint above a link without mass stands at the origin of the next in MuJoCo
? mjcf::a_link_without_mass_is_one_body_with_the_next_and_moves_as_here
- element.set("pos", numbers_text(above.anchor))
+ element.set("pos", "0 0 0")
* the joint above a link without mass is not turned into the next in MuJoCo
? mjcf::a_link_without_mass_is_one_body_with_the_next_and_moves_as_here
- direction = step.rotation.T @ joint.direction
+ direction = joint.direction
cranedyn/bridges/joints.py
* a link so light that Gazebo drops it is exported
? ros2::a_link_so_light_that_gazebo_drops_it_and_all_below_is_refused
- if len(numbers) == 4 and 0.0 < numbers[0] <= least_mass:
+ if False:
* a controller of the crane's own file acts beside that of the export
? ros2::control_of_the_file_is_replaced_and_named
- if child.tag == "plugin":
+ if child.tag == "none":
* a link without gravity floats in Gazebo
? ros2::control_of_the_file_is_replaced_and_named
- elif child.tag in _GAZEBO_DYNAMICS:
+ elif child.tag == "none":
* two falls are exported as if they were of another length
? ros2::two_falls_are_exported_with_the_stiffness_of_the_length_at_the_start
- length = float(crane.start.q[falls.length])
+ length = 2.0 * float(crane.start.q[falls.length])
* a rope that goes slack is exported as one that pulls with no force
? bridges::a_rope_that_goes_slack_without_stretching_is_refused_with_the_number_that_helps
- if rope.inextensible:
+ if False:
* Gazebo drops the inertia of a motor
? ros2::the_inertia_of_a_motor_which_gazebo_does_not_know_is_refused
- float(dynamics.get("armature", "0"))
+ float(dynamics.get("armature", "0")) < 0.0
cranedyn/bridges/mcap.py
* messages of a recording are published at the epoch
? mcap::messages_are_published_when_they_are_logged
- publish_time=time
+ publish_time=0
* joint states of a recording tell the command as effort
? mcap::a_command_that_a_drive_cuts_is_told_as_it_was_given
- efforts[:, [moving.index(joint) for joint in driven]] = run.effort
+ efforts[:, [moving.index(joint) for joint in driven]] = run.command
* frames of a recording are those of parents in their children
? mcap::the_frames_put_the_load_where_the_model_does
- parent.actInv(child)
+ child.actInv(parent)
* static frames of a recording reach nobody who comes late
? mcap::what_is_published_once_plays_back_to_who_comes_late
- reliability: 1, durability: 1
+ reliability: 1, durability: 2
* a recording tells what acted as what was commanded
? mcap::a_command_that_a_drive_cuts_is_told_as_it_was_given
- np.empty(0), run.command[k])
+ np.empty(0), run.effort[k])
cranedyn/model/options.py
* a run is read with a crane that has other coordinates
? mcap::a_run_of_another_crane_is_refused_with_the_coordinates_of_both
- if recorded != expected:
+ if False:
* the record of a run does not say which crane it was
? mcap::the_command_writes_a_run_with_the_crane_that_its_record_names
- if run.record and not named:
+ if run.record and named:
cranedyn/references/simple.py
* a spline has its rates for accelerations
? references::positions_are_the_integrals_of_velocities_and_these_of_accelerations
- curve.derivative(), curve.derivative(2)
+ curve.derivative(), curve.derivative()
cranedyn/estimation/mpc.py
* swings may be nine times their bound
? mpc::a_swing_beyond_its_bound_is_no_contradiction_and_is_brought_within
- np.full(len(crane.swings), swing)
+ np.full(len(crane.swings), 9.0 * swing)
cranedyn/dynamics/joint_forces.py
* a rope that is pushed seems to pull
? dynamics::a_falling_load_leaves_the_rope_slack
- joint.resistance_of(i, v[i]) - hoist
+ abs(joint.resistance_of(i, v[i]) - hoist)
cranedyn/bridges/fmi.py
* the index of a derivative in FMI 2 counts from 0
? fmi::the_description_names_the_derivatives_and_the_dimensions_of_its_variables[effort-2]
- str(variable.rate_of + (0 if is_fmi3 else 1))
+ str(variable.rate_of)
* a torque has the base units of a force
? fmi::the_description_names_the_derivatives_and_the_dimensions_of_its_variables[effort-3]
- "N.m": {"kg": "1", "m": "2", "s": "-2"},
+ "N.m": {"kg": "1", "m": "1", "s": "-2"},
cranedyn/bridges/fmi_unit.h
* any bytes are a state, and index tables
? fmi::altered_bytes_of_a_state_are_refused_before_a_table_is_read_with_them
- if (!is_state(data)) {
+ if (false) {
* a crane at fault in a unit steps on without a word
? fmi::a_crane_in_a_unit_says_that_an_input_is_impossible_and_stays_as_it_is
- if (!sound && STATES)
+ if (false)
* a state that is no number goes into a unit
? fmi::model_exchange_discards_states_that_are_no_numbers_and_goes_on_from_others
- if (!isfinite(states[i]))
+ if (false)
* a trial state that fails makes the unit fail for good
? fmi::model_exchange_discards_states_that_are_no_numbers_and_goes_on_from_others
- data->model.fault = false;
+
* a unit forgets that its model ceased to hold
? fmi::a_unit_says_once_the_model_no_longer_holds
- data->invalid |= !data->valid;
+ data->invalid = 0;
* a unit begins at 0 whatever it is told
? fmi::time_goes_on_from_the_start_that_the_importer_names
- unit->data.time = start;
+ unit->data.time = 0.0 * start;
* a unit that diverges goes on
? fmi::a_run_that_diverges_is_an_error_that_says_when
- if (!(fastest < 1e6))
+ if (fastest > 1e60)
cranedyn/compiled/printing.py
* a difference of a difference loses its parentheses
? c_code::a_crane_of_another_topology_and_rule_in_c_passes_its_own_test
- right.within(binding, sign, right=True)
+ right.within(binding, sign)
cranedyn/compiled/c_routines.py
* a number in C is read again after it has been written
? c_code::a_controller_in_c_commands_what_it_commands_in_python[predictive, efforts]
- instruction.opname in ("load", "select") or compound
+ compound
* a loop in C begins a row late
? c_code::a_controller_in_c_commands_what_it_commands_in_python[predictive, efforts]
- {name} = {begin.text};
+ {name} = {begin.text} + 1;
cranedyn/compiled/c_text.py
* a block in C takes what is no number
? c_code::an_input_out_of_range_is_a_fault_until_the_reset
- *_input_check(block, language)
+
* a block in C stores results that are no numbers
? block::a_result_that_is_no_number_is_a_fault_in_c[root]
- lines += _return_if_any_fails(walk.checks, language)
+
* a block in C is sound again in the call after a fault
? c_code::an_input_out_of_range_is_a_fault_until_the_reset
- checks = ["!self->fault"]
+ checks = ["true"]
* a block in C does not look at its parameters
? controller_block::a_crane_in_c_stands_still_at_a_fault_and_is_never_nan[effort-double]
- for variable in block.of_kind("input", "parameter"):
+ for variable in block.of_kind("input"):
cranedyn/compiled/functions.c.in
* an input in C needs to keep one of its two bounds
? c_code::an_input_out_of_range_is_a_fault_until_the_reset
- return x >= low && x <= high;
+ return x >= low || x <= high;
* NaN lies in every range in C
? c_code::an_input_out_of_range_is_a_fault_until_the_reset
- return x >= low && x <= high;
+ return !(x < low || x > high);
cranedyn/compiled/horizon/riccati.py
* the cost beyond a horizon is that of a stage less
? horizon_solver::the_cost_beyond_the_horizon_is_that_of_a_horizon_as_long_again
- with work.code.loop(0, work.shape.stages):
+ with work.code.loop(0, work.shape.stages - 1):
cranedyn/compiled/horizon/model.py
* a stage is integrated to the third order
? horizon_model::a_stage_is_the_exponential_of_the_linear_crane_to_the_fourth_power_of_its_length
- _ORDER = 4
+ _ORDER = 3
cranedyn/compiled/structured_text.py
* the count of calls in Structured Text begins again at 0
? st::a_controller_in_structured_text_commands_what_it_commands_in_python[shaper-Python]
- yield f"    count := {block.first};"
+ yield "    count := 0;"
* inputs out of range are no fault in Structured Text
? st::an_input_out_of_range_is_a_fault_until_the_reset[inf-Python]
- ({value} >= {self.signed(low)}) AND ({value} <= {self.signed(high)})
+ ({value} >= {self.signed(low)}) OR ({value} <= {self.signed(high)})
* a fault in Structured Text stays after a reset
? st::an_input_out_of_range_is_a_fault_until_the_reset[nan-Python]
- yield "  fault := FALSE;"
+ yield "  fault := fault;"
* Structured Text computes although an input is out of range
? controller_block::a_rope_of_negative_length_is_a_fault_of_yielding_drives
- yield "IF NOT fault THEN"
+ yield "IF TRUE THEN"
cranedyn/compiled/block.py
* a result beyond all bounds is cut to the limit of its output
? block::an_infinite_result_is_a_fault_although_its_output_has_limits
- if name != FAULT:
+ if False:
* names of a block that differ in case alone are two
? st::names_that_are_no_identifiers_are_mapped_one_to_one
- while candidate.lower() in taken
+ while candidate in taken
cranedyn/compiled/crane_block.py
* a crane in C hoists by the cable without its offset
? c_code::parameters_of_a_crane_in_c_are_those_of_another_crane
- z[: layout.n] + self.offset
+ z[: layout.n] + 0.0 * self.offset
* frequency converters in C answer a period too early
? c_code::a_crane_in_c_moves_as_in_simulate
- code.element("converters", place) for place in places
+ value for value in heard
* frequency converters in C start from rest
? c_code::a_crane_in_c_moves_as_in_simulate
- begins = compared("==",
+ begins = compared("<",
cranedyn/bridges/controller_block.py
* a shaper at fault goes to the start of the crane
? controller_block::a_shaper_at_fault_holds_its_position_until_a_reset
- return held, {}
+ return array(self._targets), {}
* drives at fault coast
? controller_block::accelerations_at_a_fault_brake_each_drive_to_rest_within_its_limit
- _within(rate * (-1.0 / period), limit)
+ _within(0.0 * rate, limit)
* efforts at fault drop the load
? controller_block::efforts_at_a_fault_end_at_the_weight_of_the_load_after_a_quarter_of_a_second
- self._targets = [output.start for output in outputs]
+ self._targets = [0.0 for output in outputs]
* rates at fault are zero at once
? controller_block::no_output_in_structured_text_is_nan_or_jumps_at_a_fault[lqr, rates]
- steps = period * self._accelerations
+ steps = 1e6 * self._accelerations
* a rope of negative length is read
? controller_block::a_rope_of_negative_length_is_a_fault_of_yielding_drives
- self.lowest = {setting.state[hoist]: 0.0}
+ self.lowest = {}
* the block of an observer corrects with the rates of a call before
? c_code::a_controller_in_c_commands_what_it_commands_in_python
- code.plus(code.count, -1)
+ code.plus(code.count, -2)
cranedyn/bridges/templates/page/input.js
* the stick of the hoist lowers when it is pushed forward
? page_browser::a_key_moves_its_drive_in_its_sense
- axis[2] < -0.5) ? -1 : 1
+ axis[2] < -2.5) ? -1 : 1
cranedyn/bridges/commissioning/opcua.py
* a client with any certificate gets in
? servers::only_the_user_with_the_password_and_a_trusted_certificate_gets_in
- self._trusted is None or certificate in self._trusted
+ True
* a header makes the server collect as much as it announces
? servers::a_message_larger_than_the_buffer_closes_its_connection_before_it_is_collected
- if not _HEADER < size <= MAX_CHUNK:
+ if not _HEADER < size:
cranedyn/bridges/commissioning/served_crane.py
* a client that falls silent leaves the crane moving
? served_crane::without_a_heartbeat_an_enabled_crane_stops_after_half_a_second_and_says_why
- if self.t - self._heard > w.TIMEOUT:
+ if self.t - self._heard > 1e9:
* a lost message is taken all the same
? served_crane::under_an_injected_fault_the_crane_stops_and_says_why
- commands = {**self._last_commands, "inject": commands["inject"]}
+ commands = {**commands}
* a fault is reset while a drive is enabled
? served_crane::a_fault_stays_until_a_reset_rises_while_no_drive_is_enabled
- and not self._resetting and not enabled.any():
+ and not self._resetting:
* drives do not brake before the ends of their ranges
? served_crane::at_full_speed_every_drive_stops_before_the_end_of_its_range
- return np.clip(command, -bound[0], bound[1])
+ return command
* an encoder that jumps is believed
? served_crane::under_an_injected_fault_the_crane_stops_and_says_why
- / self._counts) > TOLERANCE
+ / self._counts) > 1e9
cranedyn/bridges/commissioning/words.py
* a word of a served crane is any number
? served_crane::a_command_that_is_no_number_of_its_type_leaves_the_last_one
- and low <= value <= high
+
cranedyn/bridges/commissioning/modbus.py
* a negative number over Modbus is a large one
? servers::the_map_in_csv_leads_to_every_word_in_both_protocols
- (value + half) % 0x10000 - half
+ value
cranedyn/bridges/commissioning/serve.py
* that a folder cannot be written is found out at the end of the run
? servers::a_folder_that_cannot_be_written_is_refused_before_anything_is_served
- check_new_folder(folder)
+ pass
* a second Ctrl-C throws the recording away
? servers::ctrl_c_ends_within_two_seconds_and_a_second_one_loses_nothing
- with defer_sigint() as stopped:
+ with contextlib.nullcontext(lambda: False) as stopped:
* Modbus is open to other machines without being told
? servers::beyond_this_machine_opc_ua_needs_a_certificate_and_a_user_and_modbus_a_word
- if options.modbus and options.modbus[0] not in LOCAL and not options.insecure_modbus:
+ if False:
cranedyn/bridges/matlab.py
* the delay of converters is not in the sampled system
? matlab::the_file_has_the_matrices_with_names_and_units
- delay = converters.delay_steps(dt, control_period) if converters else 0
+ delay = 0
cranedyn/bridges/templates/page/assist.js
* a drive brakes by its usual ramps, whatever they are
? page::a_drive_stops_before_the_end_of_its_range_by_any_ramp
- this.ramps * this.data.accelerations[i]
+ this.data.accelerations[i]
* the shaper runs into the end of a range
? page::a_drive_stops_before_the_end_of_its_range_by_any_ramp
- return this.limited(this.shaped(asked, q), q);
+ return this.shaped(asked, q);
cranedyn/bridges/templates/page/kernel.js
cranedyn/bridges/templates/page/run.js
* a file of inputs is taken up to where it is wrong
? page::a_file_that_holds_no_inputs_of_a_drive_is_refused_as_a_whole
- if (reason !== null) return `Input
+ if (false) return `Input
* an assistance may command what is no number
? page::no_state_makes_an_assistance_command_what_is_no_number
- if (!rates.every(Number.isFinite))
+ if (false)
* a drive takes sticks beyond their ends
? page::an_impossible_input_ends_a_drive_before_it_reaches_the_crane
- sticks: () => numbers(value, 1),
+ sticks: () => numbers(value, 2),
* predictive control runs out of a range
? page::predictive_control_keeps_to_the_ramps_and_to_the_ranges_of_the_drives
- this.assistant.limited(kernel.plan(this.k), q)
+ kernel.plan(this.k)
cranedyn/bridges/page.py
* a site is turned the wrong way on the page
? page::a_site_is_turned_so_that_its_heading_is_where_the_jib_points
- Rotation.from_euler("z", -(site.heading + math.pi / 2.0))
+ Rotation.from_euler("z", (site.heading + math.pi / 2.0))
cranedyn/bridges/c_code.py
* the test of exported C takes any number
? c_code::the_test_of_the_exported_folder_takes_round_off_and_no_more
- TOLERANCE = {"double": 1e-12,
+ TOLERANCE = {"double": 1e-2,
cranedyn/compiled/horizon/planning.py
* failures of a plan are not counted
? horizon::after_each_failure_the_next_plan_begins_farther_from_its_bounds
- self._mark("failures") + code.chosen(solved, 0.0, 1.0)
+ code.chosen(solved, 0.0, 1.0)
* a plan on a motion forgets the accelerations of the motion
? horizon::on_its_motion_it_plans_the_accelerations_of_the_motion_whatever_they_cost
- rising = (coming - now)
+ rising = 0.0 * (coming - now)
cranedyn/bridges/margins.py
* margins overlook half of the sampling rate
? margins::a_drive_is_unstable_just_beyond_what_its_margins_say
- gains = np.append(gains, [-1.0 / end] if end < 0.0 else [])
+ gains = np.append(gains, [])
* margins are those of crossings of the positive axis
? margins::a_drive_is_unstable_just_beyond_what_its_margins_say
- on_grid.real[:-1] <= 0.0
+ on_grid.real[:-1] >= 0.0
cranedyn/command.py
* an unknown option is answered without the nearest
? help::an_unknown_option_is_answered_with_the_nearest_on_one_line
- self.error(f"There is no option {option}{nearest(option, known)}; --help lists them.")
+ self.error(f"There is no option {option}; --help lists them.")
cranedyn/__main__.py
* an exporter computes before it refuses a target
? bridges::a_target_that_exists_stays_as_it_is[page.html]
- check_free(options.target)
+ pass
experiments/harness/outcome.py
* what holds stands before what is not judged
? terminal::a_screen_has_24_lines_the_failed_claim_whole_and_says_what_is_left_out
- others = [claim for claim in outcome.claims if claim.verdict is Verdict.NOT_JUDGED]
+ others = [claim for claim in outcome.claims if claim.verdict is not Verdict.FAILS]
experiments/harness/document.py
* links and files of tables have units in their names
? document::a_block_of_csv_has_links_only_and_the_tables_lie_beside_the_page
- re.sub(r"(: \(| \[).*", "", title)
+ title
experiments/report.py
* the report runs one experiment after the other
? report::two_experiments_run_side_by_side_and_one_that_fails_stops_no_other
- with ThreadPoolExecutor(options.jobs) as pool:
+ with ThreadPoolExecutor(1) as pool:
cranedyn/plugins.py
* a module that cannot be parsed hides the exporters of all packages
? plugins::a_broken_exporter_of_another_package_takes_no_other_with_it
- except (Exception, SystemExit):
+ except (ImportError, OSError):
* an exporter of another package replaces one of ours
? plugins::an_exporter_of_another_package_writes_what_it_says_and_replaces_none_of_ours
- value = _own(kind).get(name) or _foreign(kind).get(name)
+ value = _foreign(kind).get(name) or _own(kind).get(name)
"""
"""A file, and below it its mutations: fault (*), test (?), lines removed (-) and added (+)."""


def read_table(table: str) -> list[Mutation]:
    """Return the mutations of a table."""
    rows: list[dict[str, list[str]]] = []
    file = ""
    for line in table.strip().splitlines():
        if line[0] not in "*?-+":
            file = line
            continue
        if line[0] == "*":
            rows.append({"": [file]})
        rows[-1].setdefault(line[0], []).append(line[2:])
    return [Mutation(*("\n".join(row[mark]) for mark in ["", *"*?-+"])) for row in rows]


def mutated(text: str, mutation: Mutation) -> str:
    """Return a text with a mutation; line breaks in the replaced code do not matter.

    Raises:
        SystemExit: If the text does not hold the code to replace exactly once.
    """
    tokens = re.findall(r"\w+|[^\w\s]", mutation.old)
    pattern = r"\s*".join(r"(?:,\s*)?" * (token in ")]}") + re.escape(token) for token in tokens)
    matches = re.findall(pattern, text)
    if len(matches) != 1:
        raise SystemExit(
            f"{mutation.file} holds the code that mutation {mutation.fault!r} replaces "
            f"{len(matches)} times, not once."
        )
    return text.replace(matches[0], mutation.new)


def write_source(path: Path, text: str) -> None:
    """Write a source file and remove its outdated bytecode."""
    path.write_text(text, encoding="utf-8")
    Path(importlib.util.cache_from_source(str(path))).unlink(missing_ok=True)


def find_test(test: str, root: Path) -> Path:
    """Return the one file below a folder that defines a test.

    Raises:
        SystemExit: If no file defines it, or several do.
    """
    file, name = re.split(r"::|\[", test)[:2]
    files = (root / "tests").rglob(f"test_{file}.py")
    paths = [path for path in files if f"\ndef test_{name}(" in path.read_text("utf-8")]
    if len(paths) != 1:
        raise SystemExit(f"{len(paths)} files test_{file}.py define test_{name}, not one.")
    return paths[0]


def fork_test(test: str, copy: Path) -> int:
    """Run a test of a copy in a forked process, with its output in the copy's file "output"; return
    the process id.
    """
    path, name = find_test(test, copy), test.split("::")[1]
    if process := os.fork():
        return process
    status = -1
    try:
        output = os.open(copy / "output", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for stream in (1, 2):
            os.dup2(output, stream)
        os.chdir(copy)
        os.environ |= {"PYTHONPATH": str(copy), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
        sys.path.insert(0, str(copy))
        del sys.modules["tests"]
        options = ["-p", "no:cacheprovider", f"--basetemp={copy / 'temporary'}", "-o", "addopts="]
        status = pytest.main(["-q", "-x", *options, f"{path}::test_{name}"])
        sys.stdout.flush()
    finally:
        # Exit handlers belong to the parent process.
        os._exit(status)


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.mutations",
        description="Break the physics and see that the tests notice.",
    )
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count(), metavar="N", help="processes at a time"
    )
    parser.add_argument(
        "--only", metavar="TEXT", default="", help="only mutations and files that hold this text"
    )
    options = parser.parse_args(argv)
    mutations = [m for m in read_table(TABLE) if options.only in f"{m.file} {m.fault}"]
    for module in SHARED:
        importlib.import_module(module)
    # Failing examples need not shrink; the profile of the tests inherits the phases.
    hypothesis.settings.register_profile("first", phases=[Phase.explicit, Phase.generate])
    hypothesis.settings.load_profile("first")
    # Forked processes look for no garbage among the shared modules.
    gc.collect()
    gc.freeze()
    queue, running, survivors = mutations[::-1], dict[int, tuple[Mutation, Path, str]](), 0
    with tempfile.TemporaryDirectory() as parent:
        idle = [Path(parent, str(i)) for i in range(options.jobs)]
        while queue or running:
            if queue and idle:
                mutation, copy = queue.pop(), idle.pop()
                if not copy.exists():
                    shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*NOT_COPIED))
                source = (copy / mutation.file).read_text("utf-8")
                write_source(copy / mutation.file, mutated(source, mutation))
                running[fork_test(mutation.test, copy)] = mutation, copy, source
                continue
            process, status, usage = os.wait4(-1, 0)
            mutation, copy, source = running.pop(process)
            write_source(copy / mutation.file, source)
            idle.append(copy)
            caught = os.waitstatus_to_exitcode(status) == 1
            output = (copy / "output").read_text("utf-8", "replace")
            failures = re.findall(r"^(?:FAILED|ERROR).*?(?= - |$)", output, re.MULTILINE)
            survivors += not caught
            print(
                f"{'caught' if caught else 'SURVIVES':9}{usage.ru_utime + usage.ru_stime:5.1f} s  "
                f"{mutation.fault}: {failures[0] if failures else output[-600:]}",
                flush=True,
            )
    print(f"{len(mutations) - survivors} of {len(mutations)} mutations caught.")
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
