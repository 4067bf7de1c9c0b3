"""The page in which one drives, in a real browser: hands, pictures, and nothing from anywhere."""

from __future__ import annotations

import base64
import io
import itertools
import json
import math
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from cranedyn.dynamics.converters import converters
from cranedyn.export import driving_page, exercises
from cranedyn.export.browser_crane import usual_limits
from cranedyn.model.load import load_crane
from tests.export import test_page
from tests.portal import portal_crane

selenium = pytest.importorskip(
    "selenium.webdriver", reason="extra browser (selenium) is not installed"
)
CHROMIUM, DRIVER, TSC = map(shutil.which, ("chromium", "chromedriver", "tsc"))
browser = pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="Chromium and its driver are not installed"
)
SCRIPTS = [*driving_page._TEMPLATES.glob("*.js"), driving_page._TEMPLATES / "types.d.ts"]

OPTIONS = (
    "--headless=new --no-sandbox --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --use-gl=angle --use-angle=swiftshader "
    "--enable-unsafe-swiftshader --window-size=1200,700"
)

DRIVES = ("gamma", "x", "l")

KEYS = {
    "ArrowLeft": (1, 0, 0),
    "KeyD": (-1, 0, 0),
    "ArrowUp": (0, 1, 0),
    "KeyS": (0, -1, 0),
    "KeyR": (0, 0, -1),
    "PageDown": (0, 0, 1),
}
"""Keys with the sense of slew, trolley and hoist: left is counter-clockwise, forward outward, and
up a shorter cable."""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of the tower crane with the exercise that needs no plan."""
    data = test_page.data_of("tower")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(driving_page, "page_data", lambda *_: data)
        return driving_page.export(tmp_path_factory.mktemp("page") / "crane.html", load_crane())


def open_browser(profile: Path, *words: str) -> Any:
    """Start Chromium without a window."""
    options = selenium.ChromeOptions()
    options.binary_location = CHROMIUM
    for word in (*OPTIONS.split(), *words, f"--user-data-dir={profile}"):
        options.add_argument(word)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = selenium.Chrome(options=options, service=selenium.ChromeService(DRIVER))
    driver.set_script_timeout(300)
    return driver


@pytest.fixture(scope="module")
def driver(file: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    driver = open_browser(tmp_path_factory.mktemp("profile"))
    try:
        driver.get(file.as_uri())
        wait(driver, "page.state && page.state.t > 0")
        yield driver
    finally:
        driver.quit()


def in_chromium(
    driver: Any, file: Path, data: dict[str, Any], *requests: dict[str, Any]
) -> list[dict[str, Any]]:
    """Drive in Chromium, in a page without a picture."""
    text = f"<script>{test_page.script()}\nconst data = {json.dumps(data)};</script>"
    file.write_text(text, "utf-8")
    driver.get(file.as_uri())
    return driver.execute_async_script(
        "const [requests, done] = arguments; drive(data, requests).then(done);", requests
    )


def wait(driver: Any, condition: str) -> None:
    """Wait until a condition holds in the page."""
    driver.execute_async_script(
        f"const done = arguments[0]; (function look() {{ ({condition}) ? done() : "
        "setTimeout(look, 20); })()"
    )


def reset_and_pause(driver: Any) -> None:
    """Have the page wait at the start, however late it is looked at."""
    driver.execute_script("page.act('KeyP'); page.act('Backspace')")
    wait(driver, "page.state.t < 0.1")


def press(driver: Any, code: str, kind: str = "keydown") -> None:
    driver.execute_script(
        "document.body.dispatchEvent(new KeyboardEvent(arguments[1], "
        "{code: arguments[0], bubbles: true, cancelable: true}))",
        code,
        kind,
    )


def hands(driver: Any) -> tuple[float, ...]:
    """Slew, trolley and hoist as the next message to the worker has them."""
    return tuple(driver.execute_script("return [...page.hands.sticks()]"))


@browser
def test_a_page_from_a_file_loads_nothing_and_may_not(driver: Any) -> None:
    assert driver.current_url.startswith("file://")
    script = "return performance.getEntriesByType('resource').map(entry => entry.name)"
    loaded = driver.execute_script(script)
    assert all(name.startswith(("blob:", "data:")) for name in loaded)
    refused = driver.execute_async_script(
        "const done = arguments[0]; addEventListener('securitypolicyviolation', event => "
        "done(event.effectiveDirective)); fetch('http://127.0.0.1:9/').catch(() => 0)"
    )
    assert refused == "connect-src"
    messages = [entry["message"] for entry in driver.get_log("browser")]
    assert [message for message in messages if "127.0.0.1:9" not in message] == []


@browser
@pytest.mark.parametrize("key", KEYS)
def test_a_key_moves_its_drive_in_its_sense(driver: Any, key: str) -> None:
    press(driver, key)
    assert hands(driver) == KEYS[key]
    press(driver, "ShiftLeft")
    assert hands(driver) == tuple(0.25 * value for value in KEYS[key])
    press(driver, "ShiftLeft", "keyup")
    (drive,) = np.flatnonzero(KEYS[key])
    joint = load_crane().layout.index(DRIVES[drive])
    wait(driver, f"{KEYS[key][drive]} * page.state.v[{joint}] > 0.02")
    press(driver, key, "keyup")
    assert hands(driver) == (0, 0, 0)


@browser
def test_a_gamepad_has_the_sticks_of_a_cabin_with_a_dead_zone(driver: Any) -> None:
    def pad(*axes: float) -> tuple[float, ...]:
        driver.execute_script(
            "navigator.getGamepads = () => [null, {connected: true, axes: arguments[0]}]",
            list(axes),
        )
        return hands(driver)

    try:
        assert pad(-1, 0, 0, 0) == (1, 0, 0)  # left stick to the left: counter-clockwise
        assert pad(0, -1, 0, 0) == (0, 1, 0)  # forward: outward
        assert pad(0, 0, 1, -1) == (0, 0, -1)  # right stick forward: up
        assert pad(0.1, -0.1, 0.1, 0.1) == (0, 0, 0)
        assert pad(0.56, 0, 0, 0) == pytest.approx((-0.5, 0, 0))
    finally:
        driver.execute_script("navigator.getGamepads = () => []")


@browser
def test_a_stick_on_the_screen_follows_the_pointer_and_springs_back(driver: Any) -> None:
    actions = selenium.ActionChains(driver, duration=50)
    stick = driver.find_element("id", "stick_0")
    actions.click_and_hold(stick).move_by_offset(0, -200).perform()
    assert hands(driver) == pytest.approx((0, 1, 0))
    actions.release().perform()
    assert hands(driver) == (0, 0, 0)


@browser
def test_the_emergency_stop_halts_the_drives_until_it_is_released(driver: Any) -> None:
    press(driver, "KeyW")
    wait(driver, "page.state.v[1] > 0.1")
    press(driver, "Space")
    wait(driver, "page.state.stopped && Math.abs(page.state.v[1]) < 0.01")
    assert driver.find_element("id", "stop").text == "RELEASE"
    press(driver, "Space")
    wait(driver, "page.state.v[1] > 0.1")
    press(driver, "KeyW", "keyup")


@browser
def test_pictures_of_the_views_are_not_blank_and_differ(driver: Any) -> None:
    def picture(code: str) -> np.ndarray:
        address = driver.execute_script(
            "const {scene, look, state: {q}} = page; page.act(arguments[0]); scene.draw(q, look);"
            "scene._blend = 1; scene.draw(q, look); return scene.canvas.toDataURL()",
            code,
        )
        image = Image.open(io.BytesIO(base64.b64decode(address.partition(",")[2])))
        return np.asarray(image.convert("L").resize((160, 120)), dtype=float)

    pictures = {code: picture(code) for code in ("cabin", "follow", "side", "top", "KeyN")}
    driver.execute_script("page.act('KeyN')")
    for code, pixels in pictures.items():
        assert np.ptp(pixels) > 60, code
    for (a, first), (b, second) in itertools.combinations(pictures.items(), 2):
        assert np.abs(first - second).mean() > 3, (a, b)


@browser
def test_a_page_that_begins_with_the_orbit_shows_the_whole_crane(driver: Any) -> None:
    """As the page of a site does: the first view has no view before it to go round from."""
    places = driver.execute_script(
        "const {scene, look, state: {q}} = page, view = scene._view, orbit = {...scene._orbit};"
        "scene._view = ''; scene.eye.fill(0); scene.target.fill(0);"
        "scene.draw(q, {...look, view: 'orbit'});"
        "const {middle, height, crane: {ground}} = scene;"
        "const top = [middle[0], middle[1], ground + height];"
        "const foot = [middle[0], middle[1], ground];"
        "const seen = [top, foot, scene.load].map(point => scene.project(point));"
        "const {clientWidth, clientHeight} = scene.canvas;"
        "scene._view = view; scene._orbit = orbit; scene.draw(q, look);"
        "return seen.map(([x, y]) => [x / clientWidth, y / clientHeight])"
    )
    for across, down in places:
        assert 0.0 < across < 1.0 and 0.0 < down < 1.0, places


@browser
def test_a_click_on_the_ground_sets_the_goal_of_the_predictive_control(driver: Any) -> None:
    driver.execute_script("page.act('Backspace'); page.act('Digit5'); page.act('top')")
    wait(
        driver,
        "page.state.assist === 'predictive' && page.scene._blend === 1 && "
        "page.scene._view === 'top'",
    )
    goal, place, drawn, clicked = driver.execute_script(
        "const {canvas} = page.scene, [x, y] = page.scene.project([8, -9, page.data.crane.ground]);"
        "const sent = []; const post = page.worker.postMessage.bind(page.worker);"
        "page.worker.postMessage = message => { sent.push(message); post(message); };"
        "canvas.onpointerdown({pointerId: 1}); canvas.onpointerup({clientX: x, clientY: y});"
        "page.worker.postMessage = post; const [a, b] = page.look.aim;"
        "return [sent.find(({type}) => type === 'goal').position, [a, b],"
        "page.scene.project([a, b, page.data.crane.ground]), [x, y]]"
    )
    assert drawn == pytest.approx(clicked, abs=0.1)  # pixels
    assert place == pytest.approx((8.0, -9.0), abs=1e-3)
    gamma, radius, _ = goal
    assert place == pytest.approx((radius * math.sin(gamma), -radius * math.cos(gamma)), abs=1e-3)


@browser
def test_the_lesson_compares_a_period_with_the_closed_form(driver: Any) -> None:
    reset_and_pause(driver)
    crane = load_crane()
    length = crane.start.q[crane.layout.index("l")]
    closed = 2.0 * math.pi * math.sqrt(length / crane.gravity)
    driver.execute_script("page.judgePeriod(arguments[0])", 1.01 * closed)
    text = driver.find_element("id", "period_answer").get_attribute("textContent")
    assert f"{closed:.3f} s" in text
    assert "1.00 % longer" in text
    driver.execute_script("page.act('KeyP')")


@browser
def test_what_was_driven_is_saved_with_its_crane_and_replays(driver: Any) -> None:
    driver.execute_script("page.act('Digit1')")
    reset_and_pause(driver)
    press(driver, "KeyW")
    driver.execute_script("page.act('KeyP')")
    wait(driver, "page.state.v[1] > 0.1 && page.state.t > 3")
    press(driver, "KeyW", "keyup")
    driver.execute_script("page.act('KeyP')")
    inputs, table = driver.execute_async_script(
        "const done = arguments[0], texts = []; download = async (name, blob) => {"
        "  if (texts.push(await blob.text()) === 2) done(texts); };"
        "page.act('save_inputs'); page.act('save')"
    )
    record = json.loads(inputs)
    assert load_crane(from_record=record).payload_mass == load_crane().payload_mass
    assert table.count("\n") - 1 == record["instants"]
    assert table.startswith("t_s,gamma_rad")
    script = "page._replay({files: [{text: async () => arguments[0]}], value: ''})"
    driver.execute_script(script, json.dumps(record | {"crane": {}}))
    wait(driver, "document.getElementById('event').textContent.includes('another crane')")
    for wrong in ([None], [5], "text", [[0, "sticks", [0, 1]]]):
        driver.execute_script(script, json.dumps(record | {"inputs": wrong}))
        wait(driver, "document.getElementById('event').textContent.includes('is replayed')")
        driver.execute_script("page.tell('')")
    driver.execute_script(script, inputs)
    wait(driver, "page.state.replaying")
    driver.execute_script("page.act('Backspace'); page.act('KeyP')")


@browser
def test_a_reset_begins_the_task_again(driver: Any) -> None:
    driver.execute_script("page.act('stop')")
    wait(driver, "page.state.task && page.state.t > 0.5")
    reset_and_pause(driver)
    wait(driver, "page.state.task && page.state.task.time < 0.4 && page.state.swing > 0.05")
    driver.execute_script("page.act('free'); page.act('KeyP')")
    wait(driver, "!page.state.task")


@browser
def test_a_wall_does_not_hide_the_load_that_is_followed(driver: Any) -> None:
    free, cut, hidden = driver.execute_script(
        "const {scene, state: {q}} = page, {gl, canvas} = scene, seen = [];"
        "for (const [view, wall] of [['follow', false], ['follow', true], ['orbit', true]]) {"
        "  const look = {...page.look, night: false, view}; scene.build([]);"
        "  scene.draw(q, look); scene._blend = 1; scene.draw(q, look);"
        "  const at = scene.eye.map((x, k) => (x + scene.load[k]) / 2);"
        "  const corners = [[-9, -9], [9, -9], [9, 9], [-9, 9]].flatMap(([across, up]) =>"
        "    at.map((x, k) => x + across * scene.right[k] + (k > 1 ? up : 0)));"
        "  const solid = {zone: false, vertices: corners, triangles: [0, 1, 2, 0, 2, 3]};"
        "  if (wall) scene.build([solid]);"
        "  scene.draw(q, look);"
        "  const pixel = new Uint8Array(4), scale = canvas.width / canvas.clientWidth;"
        "  const [x, y] = scene.project(scene.load).map(place => place * scale);"
        "  gl.readPixels(x, canvas.height - y, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);"
        "  seen.push([...pixel]); }"
        "page._build(); return seen"
    )
    assert free == cut != hidden


@browser
def test_a_mesh_is_drawn(driver: Any) -> None:
    without, drawn = driver.execute_script(
        "const {scene, state: {q}, data: {crane}} = page, {gl, canvas} = scene, seen = [];"
        "const look = {...page.look, night: false, view: 'side'};"
        "const {joint, point} = crane.points[crane.points.length - 1];"
        "const mesh = {kind: 'mesh', joint, colour: [1, 0, 0, 1], payload: true, size: [6, 6, 6],"
        "  rotation: [1, 0, 0, 0, 1, 0, 0, 0, 1], translation: point,"
        "  vertices: [3, 0, -2, -2, 3, -2, -2, -3, -2, 0, 0, 3],"
        "  triangles: [0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3]};"
        "for (const shapes of [[], [mesh]]) {"
        "  scene.crane = {...crane, shapes}; scene.build([]);"
        "  scene.draw(q, look); scene._blend = 1; scene.draw(q, look);"
        "  const pixel = new Uint8Array(4), scale = canvas.width / canvas.clientWidth;"
        "  const [x, y] = scene.project(scene.load).map(place => place * scale);"
        "  gl.readPixels(x + 4, canvas.height - y, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);"
        "  seen.push([...pixel]); }"
        "scene.crane = crane; page._build(); return seen"
    )
    assert drawn[0] > drawn[1] + 60 and abs(without[0] - without[1]) < 60, (without, drawn)


@browser
def test_a_picture_that_is_lost_comes_back(driver: Any) -> None:
    driver.execute_script(
        "window.lost = page.scene; const way = lost.gl.getExtension('WEBGL_lose_context');"
        "way.loseContext(); setTimeout(() => way.restoreContext(), 500)"
    )
    wait(driver, "page.scene !== lost && !page.scene.gl.isContextLost()")
    pixel = driver.execute_script(
        "const {scene, look, state: {q}} = page, {gl} = scene, pixel = new Uint8Array(4);"
        "scene.draw(q, look); gl.readPixels(9, 9, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);"
        "return [...pixel]"
    )
    assert max(pixel[:3]) > 60


@contextmanager
def opened(
    driver: Any, file: Path, data: dict[str, Any], width: int, height: int, *, phone: bool = False
) -> Iterator[None]:
    """Open the page of some data in another tab of the browser, in a window of a size [pixels]."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(driving_page, "page_data", lambda *_: data)
        driving_page.export(file, load_crane())
    first = driver.current_window_handle
    driver.switch_to.new_window("tab")
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": phone}
    try:
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": phone})
        driver.get(file.as_uri())
        wait(driver, "page.state && page.state.t > 0 && page.scene._view === page.look.view")
        yield
    finally:
        driver.close()
        driver.switch_to.window(first)


@cache
def with_tasks() -> dict[str, Any]:
    """The data of the tower crane with its tasks, which nobody has planned."""
    crane = test_page.crane_of("tower")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exercises, "_planned", lambda crane, limits, exercise: exercise)
        limits = usual_limits(converters(crane))
        tasks = driving_page._tasks(
            list(exercises.exercises(crane, limits)), np.eye(3), np.zeros(3)
        )
        return test_page.data_of("tower") | {"tasks": list(tasks)}


def places(driver: Any, *points: list[float]) -> tuple[np.ndarray, dict[str, float]]:
    """Places of points in the window, and the part of it that panels leave free [pixels]."""
    seen, free = driver.execute_script(
        "const {scene, look, state: {q}} = page; scene.draw(q, look); scene._blend = 1;"
        "scene.free = {...scene.nextFree}; scene.draw(q, look);"
        "return [arguments[0].map(point => scene.project(point)), page.free]",
        points,
    )
    return np.array(seen), free


def check_seen(driver: Any, *points: list[float]) -> None:
    """Check that points are before the eye, that no panel hides them, and that what the eye looks
    at is in the middle of the free part.
    """
    places(driver)  # the eye has come to its place
    looked_at = driver.execute_script("return page.scene.target")
    (target, *others), free = places(driver, looked_at, *points)
    middle = (free["left"] + free["right"]) / 2.0, (free["top"] + free["bottom"]) / 2.0
    assert target == pytest.approx(middle, abs=0.5)  # pixels
    seen = np.array(others)
    assert (seen > [free["left"], free["top"]]).all(), (seen, free)
    assert (seen < [free["right"], free["bottom"]]).all(), (seen, free)


@browser
def test_who_opens_the_page_sees_the_crane_a_task_and_a_pointer_to_its_target(
    driver: Any, tmp_path: Path
) -> None:
    crane = load_crane()
    with opened(driver, tmp_path / "page.html", with_tasks(), 1440, 900):
        view, is_open, text, goal, load = driver.execute_script(
            "return [page.look.view, document.getElementById('tasks').open,"
            "document.getElementById('task_text').textContent, page.look.goal, page.scene.load]"
        )
        assert (view, is_open, text) == ("side", True, exercises.RING_TEXT)
        # At slew angle 0 the jib points along -Y; its end is where the trolley can go, and beyond.
        height = 28.0
        farthest = float(crane.upper[crane.layout.index("x")])
        check_seen(driver, goal, load, [0.0, 0.0, 0.0], [0.0, -farthest, height])
        ((x, y),), _ = places(driver, goal)
        pointer = driver.execute_script(
            "page._pointToGoal(page.state); const {style, children: [, text]} ="
            "  document.getElementById('pointer');"
            "return [...style.translate.split(' ').map(parseFloat), text.textContent]"
        )
        assert pointer[0] == pytest.approx(x, abs=1.0)
        assert abs(pointer[1] - y) < 40.0
        assert pointer[2] == f"target {np.linalg.norm(np.subtract(goal, load)):.0f} m"
        # Behind the eye the pointer is at the edge to which one has to turn.
        pointer = driver.execute_script(
            "const {scene} = page; const behind = scene.eye.map((x, k) => x - 9 * scene.forward[k]"
            "  + 99 * scene.right[k]); scene.wayTo(behind); page.look.goal = behind;"
            "page._pointToGoal(page.state);"
            "return [parseFloat(document.getElementById('pointer').style.translate), page.free]"
        )
        assert pointer[1]["right"] - 80.0 < pointer[0] < pointer[1]["right"]


@browser
@pytest.mark.long
@pytest.mark.parametrize("view", ["side", "top", "follow"])
def test_the_views_show_a_crane_that_describes_no_visuals(
    driver: Any, tmp_path: Path, view: str
) -> None:
    data = driving_page.page_data(portal_crane(tmp_path))
    with opened(driver, tmp_path / "page.html", data, 1440, 900):
        driver.execute_script("page.act(arguments[0])", view)
        load, pivot = driver.execute_script("return [page.scene.load, page.scene.rope[0]]")
        check_seen(driver, load)
        if view != "follow":
            # The rail is 60 m long, 12 m above the ground.
            check_seen(driver, pivot, [0.0, 0.0, 12.0], [60.0, 0.0, 12.0], data["tasks"][1]["goal"])


TEXTS = """
const texts = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
while (walker.nextNode()) {
  const node = walker.currentNode, parent = node.parentElement, range = document.createRange();
  if (!node.textContent.trim() || parent.closest('script, style, dialog:not([open])')) continue;
  if (!parent.checkVisibility({visibilityProperty: true})) continue;
  range.selectNodeContents(node);
  let {left, right, top, bottom} = range.getBoundingClientRect();
  for (let box = parent; box; box = box.parentElement) {
    if (getComputedStyle(box).overflowX === 'visible') continue;
    const edge = box.getBoundingClientRect();
    [left, right] = [Math.max(left, edge.left), Math.min(right, edge.right)];
    [top, bottom] = [Math.max(top, edge.top), Math.min(bottom, edge.bottom)];
  }
  if (right > left && bottom > top) texts.push([node.textContent.trim(), left, right, top, bottom]);
}
const pen = CanvasRenderingContext2D.prototype, fill = pen.fillText;
const corner = document.getElementById('strips').getBoundingClientRect();
pen.fillText = function(text, x, y) {
  const width = this.measureText(text).width;
  const left = corner.left + x - width * ({center: 0.5, right: 1}[this.textAlign] ?? 0);
  texts.push([text, left, left + width, corner.top + y - 8, corner.top + y + 1]);
};
page.strips.draw(false);
pen.fillText = fill;
return texts;
"""
"""Script that returns all texts that are seen, each with its left, right, upper and lower edge."""


@browser
def test_on_a_phone_no_texts_overlap_the_crane_is_seen_and_what_a_finger_presses_has_44_pixels(
    driver: Any, tmp_path: Path
) -> None:
    with opened(driver, tmp_path / "page.html", with_tasks(), 390, 844, phone=True):
        reset_and_pause(driver)
        goal, load = driver.execute_script("return [page.look.goal, page.scene.load]")
        check_seen(driver, goal, load, [0.0, 0.0, 0.0], [0.0, -22.0, 28.0])
        panels = ["tasks", "reading", "charts", "lesson", "settings"]
        for panel in panels:
            driver.execute_script("document.getElementById(arguments[0]).open = true", panel)
            others = (
                f"document.querySelectorAll('#panels details[open]').length === 1 && {panel}.open"
            )
            wait(driver, others)
            # Two pictures later, what points into the picture has moved with its free part.
            driver.execute_async_script(
                "const [done] = arguments, next = requestAnimationFrame;"
                "next(() => next(() => next(done)))"
            )
            texts = driver.execute_script(TEXTS)
            assert len(texts) > 20
            for (a, *first), (b, *second) in itertools.combinations(texts, 2):
                across = min(first[1], second[1]) - max(first[0], second[0])
                along = min(first[3], second[3]) - max(first[2], second[2])
                assert min(across, along) < 1.0, (panel, a, b)
            small = driver.execute_script(
                "return [...document.querySelectorAll('button, .button, summary')]"
                ".filter(each => each.checkVisibility()).map(each => [each.textContent,"
                "  each.getBoundingClientRect()]).filter(([, {width, height}]) =>"
                "  Math.min(width, height) < 44).map(([text]) => text)"
            )
            assert small == [], panel
        help_text = driver.execute_script("page.act('KeyH'); return document.body.innerText")
        assert "left stick across" in help_text and "Shift" not in help_text


@pytest.mark.skipif(TSC is None, reason="TypeScript (npm) is not installed")
def test_the_types_of_the_scripts_hold() -> None:
    words = "--noEmit --allowJs --checkJs --strict --target es2022 --lib dom,dom.iterable,es2022"
    done = subprocess.run([TSC, *words.split(), *SCRIPTS], capture_output=True, text=True)  # type: ignore[list-item]
    assert done.returncode == 0, done.stdout


@browser
@pytest.mark.long
def test_the_crane_of_a_browser_is_that_of_simulate(driver: Any, tmp_path: Path) -> None:
    driver.execute_script("window.open()")
    first, second = driver.window_handles
    driver.switch_to.window(second)
    drive = partial(in_chromium, driver, tmp_path / "kernel.html")
    try:
        test_page.check_itinerary(drive, 1000, 9500, 12000)
    finally:
        driver.close()
        driver.switch_to.window(first)
