"""What was identified becomes a crane in a file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cranedyn.errors import DataError
from cranedyn.identification import Model, Prior, Record, identify, preflight, read_twin, twin_of
from cranedyn.model.load import load_crane
from cranedyn.model.options import parse_values
from tests.identification.test_estimate import TRUTH, found, recorded

pytestmark = pytest.mark.slow


def test_a_twin_is_read_back_and_is_the_crane_that_was_found(tmp_path: Path) -> None:
    twin = twin_of(found())
    file = twin.write(tmp_path / "twin.json")
    again = read_twin(file)
    loaded = load_crane(from_record=file)
    assert again.identified == twin.identified
    devices = {"l_offset", "delay", "phi_bias", "theta_bias", "x_friction"}
    assert devices <= again.identified.keys()
    assert again.records == ("record",)
    for crane in (again.crane, loaded, load_crane(**parse_values([str(file)]))):  # type: ignore[arg-type]
        assert crane.payload_mass == twin.crane.payload_mass == found().value("payload_mass")
        assert np.array_equal(crane.damping, twin.crane.damping)
    assert twin.options == (
        f"--gravity 9.80665 --set damp_swing:={found().value('damp_swing')!r} "
        f"payload_mass:={found().value('payload_mass')!r}"
    )


def test_a_twin_run_through_its_record_shows_what_was_recorded() -> None:
    """By the compiled loop that every run has, beside the batch that the search is made of."""
    estimate = found()
    twin = twin_of(found())
    run = estimate.model.run(0, estimate.values, twin.crane)
    assert run.record["crane"]["arguments"]["payload_mass"] == found().value("payload_mass")
    t = recorded()["t_s"][30:-20]
    for symbol in ("phi", "theta"):
        seen = np.interp(t, recorded()["t_s"], recorded()[f"{symbol}_rad"])
        late = np.interp(t - estimate.value("delay"), run.t, run[f"{symbol}_rad"])
        off = np.abs(late + estimate.value(f"{symbol}_bias") - seen).max()
        assert off < 5e-6, symbol  # straight lines between rows 10 ms apart: A ω² dt² / 8
    assert run["l_m"][0] == pytest.approx(12.0 + TRUTH["l_offset"], abs=1e-3)


def test_what_the_records_say_nothing_of_has_no_interval_in_the_file(tmp_path: Path) -> None:
    """The inertia that slews, where the motion is prescribed and no torque recorded."""
    columns = {name: values for name, values in recorded().items() if name[0] != "F"}
    record = Record.of(Prior().crane, columns)
    estimate = identify(Model.of(Prior(), [record], ["l_offset", "slewing_inertia"]))
    assert estimate.margin("slewing_inertia") == np.inf
    assert estimate.value("slewing_inertia") == Prior().value("slewing_inertia")
    assert preflight(estimate.model, estimate).undetermined == ("slewing_inertia",)
    file = twin_of(estimate).write(tmp_path / "twin.json")
    assert read_twin(file).identified["slewing_inertia"]["margin"] is None


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "{}",
        '{"crane": {}, "identified": {"x": {"value": 1}}, "records": []}',
        '{"crane": 1, "identified": {}, "records": [1e999]}',
        '{"crane": {"arguments": {"payload_mass": "1e3"}}, "identified": [], "records": []}',
    ],
)  # fmt: skip
def test_a_file_that_is_no_twin_is_one_sentence(text: str, tmp_path: Path) -> None:
    file = tmp_path / "twin.json"
    file.write_text(text)
    for read in (read_twin, lambda path: load_crane(from_record=path),
                 lambda path: parse_values([str(path)])):  # fmt: skip
        with pytest.raises(DataError) as caught:
            read(file)
        assert "\n" not in str(caught.value)
    with pytest.raises(DataError, match=r"the ending must be \.json"):
        twin_of(found()).write(tmp_path / "twin.toml")


@pytest.mark.parametrize("arguments", [1, ["payload_mass"], {"payload_mass": "1e3"}, None])
def test_a_twin_whose_arguments_are_no_numbers_by_name_is_refused(
    arguments: object, tmp_path: Path
) -> None:
    content = json.loads(twin_of(found()).text)
    content["crane"]["arguments"] = arguments
    (tmp_path / "twin.json").write_text(json.dumps(content))
    with pytest.raises(DataError, match="does not name its crane"):
        read_twin(tmp_path / "twin.json")


def test_another_cranes_twin_names_it_whole(tmp_path: Path) -> None:
    """The overhead crane: two drives along a runway and a bridge, no slew."""
    known = Prior("urdf/overhead_crane.urdf.xacro", {"payload_mass": 3000.0})
    crane = known.crane
    t = np.arange(0.0, 30.0, 0.05)
    columns = {"t_s": t, "x_m": crane.start.q[crane.layout.index("x")] + 0.5 * np.tanh(t - 5.0)}
    swing = crane.layout.joints[int(crane.swings[0])].columns[0]
    columns[swing] = 0.02 * np.sin(t)
    names = ["l_offset", "damp_swing"]
    model = Model.of(known, [Record.of(crane, columns)], names)
    values = np.append(0.25, model.first[1:])
    columns[swing] = model.predicted(0, values[None])[0][0]
    estimate = identify(Model.of(known, [Record.of(crane, columns)], names))
    assert estimate.value("l_offset") == pytest.approx(0.25, abs=1e-6)
    file = twin_of(estimate).write(tmp_path / "twin.json")
    assert json.loads(file.read_text())["crane"]["driven"] == [j.name for j in crane.layout.driven]
    assert load_crane(from_record=file).layout == crane.layout
