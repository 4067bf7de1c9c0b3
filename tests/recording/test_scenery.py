"""Where a crane with a heading is drawn, what stands around it, and recordings that grow; read back
from the file.
"""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rerun.chunk import RrdReader
from rerun.components import AggregationPolicy

from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.disturbances.wind import wind
from cranedyn.dynamics.equations_of_motion import payload_position, pivot_position
from cranedyn.errors import DataError, OutOfRange
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.recording import Run, record
from cranedyn.recording.contents import Obstacle, Scenery, clock, rows_every
from cranedyn.recording.recorder import Live, describe_runs
from cranedyn.recording.scene import looks, payload_entity
from cranedyn.recording.series import plots, series_table, time_range
from cranedyn.recording.snapshot import _frame_times, snapshot
from cranedyn.references import hold, pulse, ramp
from cranedyn.simulation.simulate import simulate
from tests.rrd import chunks, numbers, poses, rows

pytestmark = pytest.mark.filterwarnings("error:::rerun")

FLOAT32 = 3e-5
"""As in test_recording [m]."""


@pytest.fixture(scope="module")
def crane() -> Crane:
    return load_crane()


@pytest.fixture(scope="module")
def moving(crane: Crane) -> Trajectory:
    """Six seconds in which all drives move in the wind."""
    reference = pulse(crane, hold(crane), "x", 1.0, at=0.5, width=2.0)
    reference = ramp(crane, reference, "gamma", 0.3, rate=0.2, at=0.5)
    reference = ramp(crane, reference, "l", -2.0, rate=1.0, at=1.0)
    blows = wind(crane, lambda t: 8.0, direction=0.4, payload_area=4.0)
    return simulate(crane, hold_controller(crane), reference, duration=6.0, disturbance=blows)


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    """Points about the vertical, from X towards Y, by sine and cosine."""
    x, y, z = np.moveaxis(np.asarray(points, dtype=float), -1, 0)
    c = np.cos(angle)
    s = np.sin(angle)
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


@pytest.mark.slow
@pytest.mark.parametrize("heading", [0.5, np.pi / 2.0, -2.5])
def test_a_crane_with_a_heading_is_turned_from_x_towards_y_about_its_foot(
    crane: Crane, moving: Trajectory, tmp_path: Path, heading: float
) -> None:
    offset = (5.0, -3.0, 1.0)
    run = Run("turned", crane, moving, offset, heading=heading)
    points = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 3.0], [-4.0, 5.0, -6.0]])
    assert_allclose(run.to_scene(points), turned(points, heading) + offset, atol=1e-12)
    path = record(tmp_path / "turned.rrd", [run], title="Turned")
    for row in (0, 60):
        frames = poses(path, row * 40_000_000)
        q = moving.q[8 * row]
        for link, position in (("hook", payload_position), ("trolley", pivot_position)):
            expected = turned(position(crane, q), heading) + offset
            found = frames[f"turned: {link}_link"][:3, 3]
            assert_allclose(found, expected, atol=FLOAT32)
            assert_allclose(run.to_scene(position(crane, q)), expected, atol=1e-9)


# --- scenery --------------------------------------------------------------------------------------

CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 2.0) for z in (0.0, 3.0)])
FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip
"""A box and its triangles, counterclockwise from outside."""

WALL = np.add(CUBE, [4.0, 0.0, 0.0])
"""The same box elsewhere."""

SOLID = 0xB9AE9BFF
"""Colour of an obstacle: grey and opaque."""

ZONE = 0xCC33113C
"""Colour of a forbidden zone: red and transparent."""

NEAR = 0xF22B05FF
"""Colour of what the load is near to."""


@pytest.fixture(scope="module")
def scene(
    crane: Crane, moving: Trajectory, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, dict[str, list]]:
    """Columns of a scenery by entity, as far as they are told."""
    scenery = Scenery(
        [
            Obstacle("wall", WALL, FACES, near=(2.5, 3.0, 4.0)),
            Obstacle("street", CUBE - [9.0, 0.0, 0.0], FACES, zone=True),
        ],
        np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]),
        {
            "centres": np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]),
            "sizes": np.array([[1.0, 2.0, 4.0], [3.0, 1.0, 2.0]]),
            "yaw": np.array([0.5, -1.2]),
        },
        (np.array([2.0, 3.5]), np.arange(18.0).reshape(2, 3, 3)),
    )
    gaps = {"a and b": np.linspace(9.0, 2.0, len(moving.since(2.0)))}
    path = record(
        tmp_path_factory.mktemp("scenery") / "scenery.rrd",
        [Run("one", crane, moving.since(2.0), scenery=scenery)],
        title="Scenery",
        gaps=gaps,
        contacts=[2.25, 5.5],
    )
    found: dict[str, dict[str, list]] = {}
    for entity, batch in chunks(path):
        columns = found.setdefault(entity, {})
        for name in batch.schema.names:
            if name == "sim_time":
                columns["ns"] = batch[name].cast("int64").to_pylist()
            else:
                columns[name.rpartition(":")[2]] = batch[name].to_pylist()
    return found


def test_an_obstacle_is_red_while_the_load_is_near_and_a_zone_is_transparent(
    scene: dict[str, dict[str, list]],
) -> None:
    wall, street = (scene[f"/one/scene/site/{i}"] for i in (0, 1))
    # The run begins at 2 s.
    assert wall["ns"] == [2_000_000_000, 2_500_000_000, 3_000_000_000, 4_000_000_000]
    assert wall["albedo_factor"] == [[SOLID], [NEAR], [SOLID], [NEAR]]
    assert street["ns"] == [2_000_000_000]
    assert street["albedo_factor"] == [[ZONE]]


def test_an_obstacle_has_its_surface_and_normals_that_point_out_of_it(
    scene: dict[str, dict[str, list]],
) -> None:
    wall = scene["/one/scene/site/0"]
    assert wall["frame"] == [["one: world"]]
    corners = np.array(wall["vertex_positions"][0])
    normals = np.array(wall["vertex_normals"][0])
    assert_allclose(corners, WALL[FACES].reshape(-1, 3), atol=1e-6)
    assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)
    middle = np.array([4.5, 1.0, 1.5])
    triangles = corners.reshape(-1, 3, 3).mean(axis=1).repeat(3, axis=0)
    assert ((triangles - middle) * normals).sum(axis=1).min() > 0.4


def test_swept_boxes_stand_where_and_as_they_were_swept(scene: dict[str, dict[str, list]]) -> None:
    swept = scene["/one/scene/swept"]
    assert_allclose(swept["half_sizes"][0], [[0.5, 1.0, 2.0], [1.5, 0.5, 1.0]])
    assert_allclose(swept["centers"][0], [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    half = np.array([0.25, -0.6])
    expected = np.stack([0 * half, 0 * half, np.sin(half), np.cos(half)], axis=1)
    assert_allclose(swept["quaternions"][0], expected, atol=1e-6)
    path = scene["/one/scene/planned"]["strips"][0]
    assert_allclose(path, [[[0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]])
    reserved = scene["/one/scene/reserved"]
    assert reserved["ns"] == [2_000_000_000, 3_500_000_000]
    assert_allclose(np.array(reserved["strips"]).ravel(), np.arange(18.0))


def test_distances_and_contacts_stand_at_their_times(
    scene: dict[str, dict[str, list]], moving: Trajectory
) -> None:
    gaps = scene["/gaps/a\\ and\\ b"]
    t = moving.since(2.0).t
    assert_array_equal(gaps["ns"], np.round(1e9 * t).astype(int))
    assert_allclose(np.ravel(gaps["scalars"]), np.linspace(9.0, 2.0, len(t)))
    contacts = scene["/gaps/contacts"]
    assert contacts["ns"] == [2_250_000_000, 5_500_000_000]
    assert np.ravel(contacts["scalars"]).tolist() == [0.0, 0.0]


# --- shapes ---------------------------------------------------------------------------------------


def test_shapes_are_as_large_as_in_the_urdf_and_turned_about_fixed_axes(
    crane: Crane, moving: Trajectory, tmp_path: Path
) -> None:
    r = 0.3
    p = -0.7
    y = 1.1
    origin = f'<origin xyz="0.1 0.2 0.3" rpy="{r} {p} {y}"/>'
    kinds = {
        "box": '<box size="1 2 4"/>',
        "cylinder": '<cylinder radius="0.5" length="3"/>',
        "sphere": '<sphere radius="0.25"/>',
    }
    visuals = "".join(
        f"<visual>{origin}<geometry>{kind}</geometry></visual>" for kind in kinds.values()
    )
    bare = re.sub(r"<visual>.*?</visual>", "", crane.urdf, flags=re.DOTALL)
    urdf = re.sub(r'(<link name="trolley_link">)', rf"\1{visuals}", bare)
    drawn = replace(crane, urdf_source=lambda: urdf)
    path = record(tmp_path / "shapes.rrd", [Run("one", drawn, moving)], title="Shapes")
    found: dict[str, dict[str, np.ndarray]] = {}
    for entity, batch in chunks(path):
        kind = entity.rpartition("/")[2]
        if entity.startswith("/one/scene/trolley_link/"):
            found[kind] = {
                name.partition(":")[2]: np.array(batch[name].to_pylist()[0])
                for name in batch.schema.names
                if name.partition(":")[2] in ("half_sizes", "centers", "quaternions", "radii",
                                              "lengths")
            }  # fmt: skip
    assert_allclose(found["box"]["half_sizes"], [[0.5, 1.0, 2.0]], atol=1e-6)
    assert_allclose(found["cylinder"]["radii"], [0.5], atol=1e-6)
    assert_allclose(found["cylinder"]["lengths"], [3.0], atol=1e-6)
    assert_allclose(found["sphere"]["half_sizes"], [[0.25, 0.25, 0.25]], atol=1e-6)
    # URDF: roll about X, then pitch about Y, then yaw about Z, all of the link.
    a = r / 2.0
    b = p / 2.0
    c = y / 2.0
    halves = {
        "x": np.sin(a) * np.cos(b) * np.cos(c) - np.cos(a) * np.sin(b) * np.sin(c),
        "y": np.cos(a) * np.sin(b) * np.cos(c) + np.sin(a) * np.cos(b) * np.sin(c),
        "z": np.cos(a) * np.cos(b) * np.sin(c) - np.sin(a) * np.sin(b) * np.cos(c),
        "w": np.cos(a) * np.cos(b) * np.cos(c) + np.sin(a) * np.sin(b) * np.sin(c),
    }
    for kind in kinds:
        quaternion = found[kind]["quaternions"][0]
        sign = np.sign(quaternion @ [*halves.values()])
        assert_allclose(sign * quaternion, [*halves.values()], atol=1e-6)
        assert_allclose(found[kind]["centers"], [[0.1, 0.2, 0.3]], atol=1e-6)


def test_only_later_cranes_of_a_place_are_transparent_and_arrows_are_of_one_scale(
    crane: Crane, moving: Trajectory
) -> None:
    calm = replace(moving, q=np.where(np.isin(np.arange(5), [2, 3]), 1e-3, 1.0) * moving.q)
    wild = moving.q.copy()
    wild[100, 2] = np.radians(30.0)
    runs = [
        Run("a", crane, calm),
        Run("b", crane, replace(moving, q=wild), colour="#123456"),
        Run("c", crane, calm, (9.0, 0.0, 0.0)),
    ]
    found = looks(runs)
    assert [look.overlaps for look in found] == [0, 1, 0]
    assert [look.label for look in found] == ["a", "b", "c"]
    assert found[1].colour == "#123456" and found[0].colour != found[2].colour
    # 30 degrees at 0.1 m each are 3 m long; at 0.2 m they would be longer than 5 m.
    assert {look.arrow for look in found} == {0.1}
    assert looks(runs[:1])[0].arrow == 0.5 and looks(runs[:1])[0].label == ""
    assert payload_entity(runs[0]).startswith("/a/scene/hook_link/")


@pytest.mark.slow
def test_of_two_cranes_in_one_place_the_first_is_opaque_and_the_second_is_not(
    crane: Crane, tmp_path: Path
) -> None:
    run = simulate(crane, hold_controller(crane), duration=0.04)
    path = record(tmp_path / "both.rrd", [Run("a", crane, run), Run("b", crane, run)], title="Both")
    alphas: dict[str, set[int]] = {"a": set(), "b": set()}
    for entity, batch in chunks(path):
        name, _, rest = entity[1:].partition("/scene/")
        link, _, kind = rest.partition("_link/")
        if link in ("upper", "trolley", "base") and kind in ("box", "cylinder"):
            colours = batch[f"{'Boxes' if kind == 'box' else 'Cylinders'}3D:colors"]
            alphas[name] |= {rgba & 255 for rgba in colours.flatten().to_pylist()}
    assert alphas["a"] and max(alphas["b"]) <= 64 < max(alphas["a"]) == 255


def test_a_joint_is_drawn_from_the_frame_on_in_which_it_moves(crane: Crane, tmp_path: Path) -> None:
    still = simulate(crane, hold_controller(crane), duration=0.4)
    q = np.tile(still.q[0], (len(still), 1))
    q[40:, 1] += 1.0  # from 0.2 s on
    path = record(tmp_path / "jump.rrd", [Run("one", crane, replace(still, q=q))], title="Jump")
    times, place = rows(path, "/joints/trolley_joint", "Transform3D:translation")
    assert times.tolist() == [0, 200_000_000]
    assert np.linalg.norm(place[1] - place[0]) == pytest.approx(1.0, abs=FLOAT32)


@pytest.mark.slow
def test_the_outline_of_a_load_on_a_lug_stands_where_the_load_would(tmp_path: Path) -> None:
    of = load_crane(lug_height=0.8)
    run = simulate(of, hold_controller(of), duration=0.04)
    path = record(tmp_path / "lug.rrd", [Run("one", of, run)], title="Lug")
    frames = poses(path, 0)
    assert_allclose(frames["one: setpoint"][:3, 3], frames["one: hook_link"][:3, 3], atol=FLOAT32)


@pytest.mark.slow
def test_a_setpoint_that_changes_for_one_drive_is_drawn(crane: Crane, tmp_path: Path) -> None:
    reference = ramp(crane, hold(crane), "l", -0.1, rate=0.5, at=0.2)
    run = simulate(crane, hold_controller(crane), reference, duration=0.6)
    path = record(tmp_path / "hoist.rrd", [Run("one", crane, run)], title="Hoist")
    times, place = rows(path, "/joints/setpoint", "Transform3D:translation")
    assert len(times) == 6 and np.ptp(place[:, 2]) == pytest.approx(0.1, abs=FLOAT32)


# --- numbers --------------------------------------------------------------------------------------


def test_forces_from_outside_are_numbers_of_a_run_that_has_them(
    crane: Crane, moving: Trajectory
) -> None:
    table = series_table(Run("one", crane, moving))
    names = [*moving.columns["force"], *moving.columns["outside"]]
    assert names and moving.force.any()
    for name in names:
        assert_array_equal(table[name], moving[name])
    calm = replace(moving, force=0.0 * moving.force, outside=0.0 * moving.outside)
    assert not table.keys() & {*names} - {*names} and not {*names} & {
        *series_table(Run("one", crane, calm))
    }


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_crane_that_stands_nowhere_or_is_turned_by_no_angle_is_refused(
    crane: Crane, moving: Trajectory, bad: float
) -> None:
    with pytest.raises(OutOfRange, match="heading of a run"):
        Run("one", crane, moving, heading=bad)
    with pytest.raises(OutOfRange, match="offset of a run"):
        Run("one", crane, moving, (0.0, bad, 0.0))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_number_that_is_not_finite_is_recorded_by_nobody(
    crane: Crane, moving: Trajectory, tmp_path: Path, bad: float
) -> None:
    for name in ("q", "v", "setpoint", "effort", "work"):
        table = getattr(moving, name).copy()
        table[7, 1] = bad
        with pytest.raises(OutOfRange, match="of run one is"):
            record(
                tmp_path / "bad.rrd",
                [Run("one", crane, replace(moving, **{name: table}))],
                title="Bad",
            )
    assert not (tmp_path / "bad.rrd").exists()


def test_curves_show_the_column_that_their_name_says(crane: Crane) -> None:
    by_title = {plot.title: plot for plot in plots(crane.layout).values()}
    columns = {
        title: {curve.label: curve.column for curve in plot.curves}
        for title, plot in by_title.items()
    }
    assert columns["Speed [m/s]"] == {"dx/dt": "x_dot_m_s", "dl/dt": "l_dot_m_s"}
    assert columns["Speed [°/s]"]["dγ/dt"] == "gamma_dot_deg_s"
    assert columns["Swing [°]"] == {"φ radial": "phi_deg", "θ tangential": "theta_deg"}
    assert columns["Trolley [m]"] == {"setpoint": "x_setpoint_m", "x": "x_m"}
    energy = columns["Energy [J]"]
    assert energy["dissipated"] == "dissipated_J" and energy["unexplained"] == "unexplained_J"
    assert energy["gained"] == "energy_J" and energy["work of hoist"] == "W_l_J"
    force = columns["Hoist force [N]"]
    assert force["F_l"] == "F_l_N"
    assert {column for label, column in force.items() if label == "limit"} <= {
        "F_l_N_lower",
        "F_l_N_upper",
    }


def test_axes_go_from_the_first_run_to_the_last_and_leave_room_for_the_legend(
    crane: Crane, moving: Trajectory
) -> None:
    early = replace(moving.since(2.0), t=moving.since(2.0).t - 1.0)
    late = moving.since(3.0)
    found = time_range([Run("late", crane, late), Run("early", crane, early)])
    ends = [int(boundary.inner.value) / 1e9 for boundary in (found.start, found.end)]
    assert ends == pytest.approx([1.0, 6.0 + 0.4 * 5.0])


@pytest.mark.parametrize("name", ["without control", "a name that is longer than any plot " * 9])
def test_a_legend_with_the_long_names_of_several_runs_has_more_room(
    name: str, crane: Crane, moving: Trajectory
) -> None:
    runs = [Run("flat", crane, moving), Run(name, crane, moving)]
    alone = time_range(runs[:1]).end.inner.value
    together = time_range(runs).end.inner.value
    duration = 1e9 * (moving.t[-1] - moving.t[0])
    assert alone < together <= 1e9 * moving.t[-1] + duration


@pytest.mark.slow
def test_a_tangential_swing_is_paler_and_peaks_are_kept(
    crane: Crane, moving: Trajectory, tmp_path: Path
) -> None:
    runs = [Run("one", crane, moving), Run("two", crane, moving.since(1.0))]
    reader = RrdReader(record(tmp_path / "two.rrd", runs, title="Two"))
    colours = {}
    policies = {}
    for chunk in reader.stream(store=reader.blueprints()[0]):
        batch = chunk.to_record_batch()
        if "SeriesLines:names" not in batch.schema.names:
            continue
        name = batch["SeriesLines:names"].flatten()[0].as_py()
        rgba = batch["SeriesLines:colors"].flatten()[0].as_py()
        colours[name] = [rgba >> shift & 255 for shift in (24, 16, 8)]
        policies[name] = batch["SeriesLines:aggregation_policy"].flatten()[0].as_py()
    for run in ("one", "two"):
        assert (np.array(colours[f"θ · {run}"]) >= colours[f"φ · {run}"]).all()
        assert sum(colours[f"θ · {run}"]) > sum(colours[f"φ · {run}"])
    extremes = AggregationPolicy.MinMax.value
    mean = AggregationPolicy.Average.value
    assert policies["F_l · one"] == policies["T_γ · one"] == extremes
    assert policies["φ · one"] == policies["dx/dt · one"] == mean


def test_rows_of_a_period_hold_the_first_and_the_last_and_none_twice() -> None:
    t = 3.0 + 0.005 * np.arange(103)
    assert rows_every(t, 0.02).tolist() == [*range(0, 101, 4), 102]
    assert rows_every(t[:1], 0.02).tolist() == [0]
    # Rows farther apart than the period are each there once.
    assert rows_every(np.array([0.0, 1.0, 2.0]), 0.3).tolist() == [0, 1, 2]


def test_times_are_the_nearest_nanoseconds() -> None:
    (column,) = clock(np.array([0.1 + 0.2, 1e-9 * 1.6, 2.0]))
    assert column.as_arrow_array().cast("int64").to_pylist() == [300_000_000, 2, 2_000_000_000]


# --- a recording that grows -----------------------------------------------------------------------


def rows_of(run: Trajectory, first: int, last: int) -> Trajectory:
    """A piece of a run, both rows included: the next one begins with the last of these. Its work
    counts from its beginning, as that of a run that goes on from there.
    """
    tables = {name: getattr(run, name)[first : last + 1] for name in run.columns}
    for name in ("work", "dissipated", "outside"):
        tables[name] = tables[name] - tables[name][0]
    return replace(run, **tables)


@pytest.mark.slow
def test_a_piece_without_rows_is_refused_in_a_sentence(
    crane: Crane, moving: Trajectory, tmp_path: Path
) -> None:
    with (
        Live(crane, "one", title="Live", file=tmp_path / "live.rrd") as live,
        pytest.raises(OutOfRange, match="number of rows of a piece is 0"),
    ):
        live.append(moving.since(1e9))


@pytest.mark.slow
def test_pieces_of_a_run_are_the_numbers_and_the_path_of_the_whole(
    crane: Crane, moving: Trajectory, tmp_path: Path
) -> None:
    file = tmp_path / "live.rrd"
    with Live(crane, "one", title="Live", file=file) as live:
        for first, last in pairwise([0, 400, 1000, len(moving) - 1]):
            live.append(rows_of(moving, first, last))
    times: list[int] = []
    columns: dict[str, list[float]] = {"energy_J": [], "unexplained_J": []}
    for entity, batch in chunks(file):
        if entity.endswith("/one/numbers"):
            times += batch["sim_time"].cast("int64").to_pylist()
            for name, values in columns.items():
                values += batch["Run:row"].flatten().field(name).to_pylist()
    order = np.argsort(times, kind="stable")
    times_sorted = np.array(times)[order]
    # Twice is only the row in which two pieces meet.
    repeated = times_sorted[1:][np.diff(times_sorted) == 0]
    assert repeated.tolist() == [2_000_000_000, 5_000_000_000]
    whole_times, whole = numbers(record(tmp_path / "w.rrd", [Run("one", crane, moving)], title="W"))
    at = np.searchsorted(whole_times, times_sorted)
    shared = np.isin(times_sorted, whole_times)
    assert shared.mean() > 0.95
    for name, values in columns.items():
        # Sums in another order, of 1e6 J in doubles, told in single precision.
        found = np.array(values)[order][shared]
        expected = whole[name][at[shared]]
        assert_allclose(found, expected, rtol=1e-6, atol=1e-6, err_msg=name)
    # The path reaches back by four seconds, into pieces before.
    paths = {}
    for entity, batch in chunks(file):
        if entity.endswith("/scene/path") and "sim_time" in batch.schema.names:
            points = batch["Points3D:positions"].to_pylist()
            paths |= dict(zip(batch["sim_time"].cast("int64").to_pylist(), points, strict=True))
    newest, oldest = (np.array(paths[6_000_000_000])[i] for i in (0, 39))
    assert_allclose(newest, payload_position(crane, moving.q[1200]), atol=FLOAT32)
    # 39 points of 0.1 s before 6 s.
    assert_allclose(oldest, payload_position(crane, moving.q[420]), atol=2e-2)


def test_the_text_says_where_the_model_does_not_hold_and_what_is_not_drawn(
    crane: Crane, moving: Trajectory
) -> None:
    fine = describe_runs([Run("one", crane, moving)], "T", "")
    assert "does not hold" not in fine and "Meshes" not in fine
    broken = simulate(
        crane, lambda *_: np.array([0.0, 0.0, 12.0]), duration=0.1, drive="motion", validity="mark"
    )
    assert not broken.valid.all()
    text = describe_runs([Run("one", crane, moving), Run("falls", crane, broken)], "T", "")
    assert "**Where the model does not hold:**\n\n- falls, 0." in text and "- one, " not in text
    mesh = '<visual><geometry><mesh filename="a.stl"/></geometry></visual>'
    urdf = crane.urdf.replace('<link name="trolley_link">', f'<link name="trolley_link">{mesh}')
    drawn = replace(crane, urdf_source=lambda: urdf)
    assert "Meshes of the URDF are not drawn." in describe_runs([Run("m", drawn, moving)], "T", "")


# --- moving pictures ------------------------------------------------------------------------------


def test_pictures_of_a_gif_come_at_their_rate_and_stay_as_long() -> None:
    times, shown = _frame_times((1.0, 2.0), 10.0, (640, 480))
    assert_allclose(times, 1.0 + 0.1 * np.arange(11))
    assert shown == [100] * 11
    times, shown = _frame_times((0.0, 1.0), 30.0, (640, 480))
    assert len(times) == 31 and {*shown} == {30, 40}
    # In hundredths of a second the sum is right though no picture is.
    assert abs(sum(shown) - 1000.0 * (1.0 + 1.0 / 30.0)) <= 5.0
    for span in ((1.0, 1.05), (2.0, 1.0), (np.nan, 1.0), (0.0, np.inf)):
        with pytest.raises(OutOfRange):
            _frame_times(span, 10.0, (640, 480))
    with pytest.raises(OutOfRange, match="number of pictures"):
        _frame_times((0.0, 1000.0), 50.0, (640, 480))


def test_pictures_are_named_by_six_digits_of_their_times(tmp_path: Path) -> None:
    with pytest.raises(OutOfRange, match="each time once"):
        snapshot(tmp_path / "none.rrd", [1.0000001, 1.0000002], tmp_path)
    # These differ, so that only the recording is missing.
    with pytest.raises(DataError, match=r"none\.rrd"):
        snapshot(tmp_path / "none.rrd", [1.2, 1.4, 1.00001], tmp_path)
    for size in ((199, 300), (300, 4001), (np.nan, 300), (np.inf, 300)):
        with pytest.raises(OutOfRange, match="of the picture"):
            snapshot(tmp_path / "none.rrd", [1.0], tmp_path, size=size)  # type: ignore[arg-type]
