"""Runs and cranes in Python, notebooks, figures and recordings, and as tables."""

from __future__ import annotations

import itertools
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text

import cranedyn as cd
from cranedyn import recording
from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import Trajectory, read
from cranedyn.errors import CraneError, UnknownColumn
from cranedyn.plotting.figures import plot_runs
from cranedyn.plotting.style import (
    COLOURS,
    RUN_COLOURS,
    colour_of,
    distinct_colours,
    rgb,
    run_colour,
)
from cranedyn.recording.sketch import sketch
from cranedyn.references import hold, pulse
from experiments.scenarios.crane_variants import CRANE_VARIANTS, CraneVariant, variant_crane
from tests.helpers import constant, crane, quickly


@pytest.fixture(scope="module")
def run() -> Trajectory:
    start = crane().state(x=12.0, l=10.0)
    wanted = pulse(crane(), hold(crane(), start), "x", 0.5, at=1.0, width=3.2)
    return quickly(crane(), hold_controller(crane()), wanted, start=start, duration=6.0)


def test_a_run_says_in_a_few_lines_how_long_it_is_and_where_the_coordinates_went(
    run: Trajectory,
) -> None:
    lines = repr(run).splitlines()
    assert lines[0] == "Trajectory of 1201 rows, t = 0 to 6 s"
    found = {line.split()[0]: [float(word) for word in line.split()[1:]] for line in lines[2:]}
    assert list(found) == ["gamma_rad", "x_m", "phi_rad", "theta_rad", "l_m"]
    values = run["phi_rad"]
    assert found["phi_rad"] == pytest.approx(
        [values[0], values[-1], values.min(), values.max()], rel=1e-5
    )
    assert max(map(len, lines)) <= 80
    assert repr(run.before(-1.0)) == "Trajectory without rows"


@pytest.mark.slow
def test_a_run_says_how_many_rows_are_not_valid_and_why() -> None:
    start = crane().state(x=12.0, l=10.0, phi=0.6)
    how = dict(start=start, duration=4.0, drive="velocity", validity="mark")
    run = quickly(crane(), constant(0.0, 5.0, 0.0), **how)
    bad = np.flatnonzero(run.valid != 1.0)
    assert len(bad) > 0
    lines = repr(run).splitlines()
    count = f"{len(bad)} of {len(run)} rows are not valid, the first at t = {run.t[bad[0]]:g}"
    assert lines[1].startswith(count)
    assert "drive" in lines[1] + lines[2]
    assert max(map(len, lines)) <= 80
    assert "not valid" not in repr(run.before(run.t[bad[0]]))


def test_a_notebook_shows_every_column_of_a_run_and_every_joint_of_a_crane(run: Trajectory) -> None:
    page = run._repr_html_()
    assert all(f">{name}</td>" in page for name in run.keys())
    shown = crane()._repr_html_()
    assert all(f"<td>{name}</td>" in shown for name in list(crane().model.names)[1:])
    assert (
        repr(crane()).splitlines()[0] == "Crane with a payload of 1000 kg in gravity of 9.81 m/s²"
    )
    assert len(repr(crane()).splitlines()) == 9  # two of them say which way a swing counts


def test_pandas_takes_a_run_as_a_table_to_the_bit(run: Trajectory) -> None:
    pandas = pytest.importorskip(
        "pandas", reason="pandas is not installed: pip install 'cranedyn[pandas]'"
    )
    for frame in (pandas.DataFrame(run), run.to_pandas()):
        assert list(frame.columns) == run.keys()
        for name in run.keys():
            assert frame[name].to_numpy().tobytes() == np.ascontiguousarray(run[name]).tobytes()
    assert run.to_pandas().attrs == dict(run.parameters)


def test_a_run_is_a_mapping_of_columns_a_sequence_of_rows_and_an_arrow_table(
    run: Trajectory,
) -> None:
    pa = pytest.importorskip("pyarrow")
    assert dict(run)["l_m"] is not None and list(dict(run)) == run.keys()
    rows = list(run)
    assert len(rows) == len(run)
    assert rows[7].phi_rad == run["phi_rad"][7]
    assert "phi_rad" in run and "phi" not in run
    assert pa.table(run).equals(run.table())


@pytest.mark.slow
def test_a_run_is_written_to_the_bit_without_an_import_of_pandas(
    run: Trajectory, tmp_path: Path
) -> None:
    """That import takes longer than the rest of a first run. It is pyarrow's, for NumPy's arrays
    where pandas is installed.
    """
    program = f"""
import sys
import numpy as np
from cranedyn.data.tables import number_array, write_table
import pyarrow as pa
rows = np.arange(12.0).reshape(6, 2)
columns = [number_array(column) for column in (rows[:, 1], rows[:, 1].astype(np.float32))]
write_table({str(tmp_path / "run.csv")!r}, pa.table(columns, names=["a", "b"]))
assert [column.to_pylist() for column in columns] == 2 * [[1.0, 3.0, 5.0, 7.0, 9.0, 11.0]]
print("pandas" in sys.modules)
"""
    command = [sys.executable, "-c", program]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "False\n"
    table = run.table()
    for name in run.keys():
        assert table[name].to_numpy().tobytes() == np.asarray(run[name]).tobytes()


def test_without_pandas_a_sentence_says_what_to_install(
    run: Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(CraneError, match=r"pip install 'cranedyn\[pandas\]'"):
        run.to_pandas()


def test_a_column_that_is_not_there_is_a_sentence_with_those_that_are(run: Trajectory) -> None:
    with pytest.raises(
        UnknownColumn, match=r"^There is no column 'phi'; there are t_s, gamma_rad, x_m, phi_rad"
    ) as caught:
        run["phi"]
    assert isinstance(caught.value, KeyError)
    with pytest.raises(UnknownColumn):
        cd.plot(run, "phi")


@pytest.mark.slow
def test_the_figure_of_a_run_has_its_drives_its_setpoints_and_its_swing(run: Trajectory) -> None:
    figure = cd.plot(run)
    *drives, swing = figure.axes
    assert [ax.get_ylabel() for ax in figure.axes] == ["γ [°]", "x [m]", "l [m]", "swing [°]"]
    np.testing.assert_array_equal(drives[1].lines[1].get_ydata(), run["x_m"])
    np.testing.assert_array_equal(drives[1].lines[0].get_ydata(), run["x_setpoint_m"])
    np.testing.assert_allclose(swing.lines[0].get_ydata(), np.degrees(run["phi_rad"]))
    assert [line.get_linestyle() for line in swing.lines] == ["-", "--"]
    assert figure._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]
    (one,) = cd.plot(run, "F_x_N").axes
    np.testing.assert_array_equal(one.lines[0].get_ydata(), run["F_x_N"])


def test_what_stands_still_is_drawn_as_a_line_and_no_axis_has_an_offset(run: Trajectory) -> None:
    figure = cd.plot(run)
    figure.canvas.draw()
    slew = figure.axes[0]
    assert np.diff(slew.get_ylim()) >= 1e-3
    assert [ax.yaxis.get_offset_text().get_text() for ax in figure.axes] == [""] * 4


def luminance(colour: str) -> float:
    """Return the relative luminance of a hex colour, 0 to 1 (WCAG 2.2)."""
    red, green, blue = (
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4
        for c in (channel / 255 for channel in rgb(colour))
    )
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(colour: str, paper: str) -> float:
    """Return the contrast of two hex colours, 1 to 21 (WCAG 2.2)."""
    light, dark = sorted((luminance(colour), luminance(paper)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def cielab(colour: str) -> np.ndarray:
    """Return lightness, green-red and blue-yellow of a hex colour (CIE 1976, white D65)."""
    channels = np.array(rgb(colour)) / 255.0
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    # IEC 61966-2-1, divided by the white point.
    to_xyz = [
        [0.4338906, 0.3762349, 0.1899105],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0177254, 0.1094753, 0.8729554],
    ]
    xyz = to_xyz @ linear
    x, y, z = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def test_each_run_has_one_colour_in_every_panel(run: Trajectory) -> None:
    names = ("one", "two", "three")
    figure = plot_runs(dict.fromkeys(names, run))
    for i, name in enumerate(names):
        lines = [line for ax in figure.axes for line in ax.lines]
        colours = {ln.get_color() for ln in lines if str(ln.get_label()).endswith(name)}
        assert colours == {run_colour(i)}


def test_columns_of_several_runs_are_drawn_in_the_colour_of_each_and_angles_in_degrees(
    run: Trajectory,
) -> None:
    half = run.since(3.0)
    figure = plot_runs({"whole": run, "late": half}, "phi_rad", "F_x_N")
    swing, force = figure.axes
    assert [swing.get_ylabel(), force.get_ylabel()] == ["phi [°]", "F_x_N"]
    for i, trajectory in enumerate((run, half)):
        curve = swing.lines[i]
        assert curve.get_color() == force.lines[i].get_color() == run_colour(i)
        assert curve.get_xydata() == pytest.approx(
            np.column_stack([trajectory.t, np.degrees(trajectory["phi_rad"])])
        )
        assert force.lines[i].get_ydata() == pytest.approx(trajectory["F_x_N"])
    legend = swing.get_legend()
    assert [text.get_text() for text in legend.get_texts()] == ["whole", "late"]


def test_a_figure_of_runs_has_the_size_and_the_letters_that_are_asked_for(run: Trajectory) -> None:
    for columns in ((), ("phi_rad", "x_m")):
        runs = {"one": run, "two": run}
        figure = plot_runs(runs, *columns, width=3.5, height=1.5, font_size=8.0)
        assert figure.get_size_inches() == pytest.approx([3.5, 1.5 * len(figure.axes)])
        figure.draw_without_rendering()
        for text in figure.findobj(Text):
            assert not text.get_text() or text.get_fontsize() == 8.0, text


def test_runs_without_a_column_or_without_a_run_are_refused(run: Trajectory) -> None:
    with pytest.raises(UnknownColumn, match="phi_deg"):
        plot_runs({"one": run}, "phi_deg")
    with pytest.raises(CraneError, match="no run to draw"):
        plot_runs({})


def test_every_colour_of_a_run_is_legible_on_white_and_on_black_and_no_two_are_alike() -> None:
    for colour in RUN_COLOURS:
        # WCAG 2.2, 1.4.11.
        assert contrast(colour, "#FFFFFF") >= 3.0 and contrast(colour, "#000000") >= 3.0
    for quantity, colour in COLOURS.items():
        assert contrast(colour, "#FFFFFF") >= 3.0
        # Black on white paper, grey elsewhere.
        assert contrast(colour, "#000000") >= 3.0 or quantity == "unexplained"
    for name in ("bridge", "sling", "rope", "anything"):
        assert min(contrast(colour_of(name), paper) for paper in ("#FFFFFF", "#000000")) >= 3.0
    assert contrast("#FFFFFF", "#000000") == pytest.approx(21.0)
    assert len(set(RUN_COLOURS)) == len(RUN_COLOURS)


@pytest.mark.parametrize(
    "symbols",
    [
        ["bridge", "cart", "sx", "sy", "rope", "luff", "boom", "sling", "yaw"],
        ["bridge", "cart", "sx", "sy", "rope", "phi", "l"],
        ["bridge", "x", "phi", "theta", "l"],
    ],
)
def test_no_two_coordinates_of_a_crane_have_colours_that_look_alike_or_like_the_energy(
    symbols: list[str],
) -> None:
    colours = distinct_colours(symbols)
    assert set(colours) == set(symbols)
    for symbol in COLOURS.keys() & colours:
        assert colours[symbol] == COLOURS[symbol]
    for colour in colours.values():
        assert min(contrast(colour, paper) for paper in ("#FFFFFF", "#000000")) >= 3.0
    beside = [COLOURS[name] for name in ("energy", "dissipated", "setpoint")]
    for first, second in itertools.combinations([*colours.values(), *beside], 2):
        # Two patches side by side are told apart from 2 on; thin lines need ten times as much.
        assert np.linalg.norm(cielab(first) - cielab(second)) > 20.0, (first, second)


@pytest.mark.slow
def test_the_sketch_has_the_load_where_the_model_has_it() -> None:
    state = crane().state(x=12.0, l=10.0)
    (ax,) = sketch(crane(), state).axes
    (cable,) = ax.lines
    np.testing.assert_allclose(cable.get_xdata(), 12.0, atol=1e-9)  # plumb below the trolley
    assert np.ptp(cable.get_ydata()) == pytest.approx(10.0)
    assert len(ax.collections[0].get_paths()) > 50


def test_a_run_is_recorded_and_opened_in_one_step(
    run: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[Path] = []
    monkeypatch.setattr("cranedyn.recording.viewer.open_viewer", opened.append)
    assert cd.view(run, crane(), file=tmp_path / "a.rrd") == tmp_path / "a.rrd"
    assert opened == [tmp_path / "a.rrd"] and (tmp_path / "a.rrd").stat().st_size > 10_000
    assert recording.Run is not None


@pytest.mark.slow
def test_a_run_is_looked_at_without_its_crane_which_its_record_names(
    run: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cranedyn.recording.viewer.open_viewer", lambda path: None)
    with_crane = cd.view(run, crane(), file=tmp_path / "a.rrd").stat().st_size
    # Looks and all.
    assert cd.view(run, file=tmp_path / "b.rrd").stat().st_size == pytest.approx(
        with_crane, rel=0.01
    )
    with pytest.raises(
        CraneError,
        match=r"names no crane, as none of a CSV file does; say which it was: "
        r"cd\.view\(run, crane\)",
    ):
        cd.view(read(run.write(tmp_path / "run.csv")), file=tmp_path / "c.rrd")


@pytest.mark.slow
@pytest.mark.parametrize("variant", CRANE_VARIANTS, ids=lambda variant: variant.name)
def test_a_crane_of_any_topology_shows_itself_and_its_runs(
    variant: CraneVariant, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cranedyn.recording.viewer.open_viewer", lambda path: None)
    made = variant_crane(variant)
    run = cd.simulate(made, hold_controller(made), start=made.start, duration=0.05)
    rows = [row.split() for row in repr(made).splitlines()[2:] if " moves the load " not in row]
    assert [(row[0], row[1]) for row in rows] == [
        (joint.symbol, joint.name) for joint in made.layout.joints
    ]
    assert [row[-1] != "passive" for row in rows] == [joint.driven for joint in made.layout.joints]
    (cable,) = cd.plot(made).axes[0].lines
    sagging = 0 if made.springs.rope is None else 7
    assert len(cable.get_xdata()) == len(made.points) + sagging
    kinds = {joint.kind for joint in made.layout.joints if not joint.driven}
    labels = [ax.get_ylabel() for ax in cd.plot(run).axes]
    assert len(labels) == made.layout.m + len(kinds)
    assert ("swing [°]" in labels) == ("revolute" in kinds) and ("stretch [m]" in labels) == (
        "prismatic" in kinds
    )
    assert cd.view(run, file=tmp_path / "run.rrd").stat().st_size > 10_000
