"use strict";
// The page around the picture: what the operator reads and sets, and the messages of the worker.

/** Time that the plots show [s]. */
const STRIP_SECONDS = 30;

/** Number of rows of the plots that are kept. */
const STRIP_ROWS = 480;

/** Time for which a notice is shown [s]. */
const NOTICE_SECONDS = 6;

/** Widest window in which panels open one at a time, below their titles [pixels]: as in style.css. */
const NARROW = 900;

/** Largest height of a phone that lies on its side [pixels]: there a panel would cover the picture. */
const LOW = 500;

/** Least height of the part of the picture that panels leave free, as a share of the window; where they
 * leave less, they lie on the picture. */
const LEAST_FREE = 0.2;

/** Distance of the pointer from the goal [pixels]. */
const POINTER_DISTANCE = 26;

/** Distance of the pointer from the edges of the free part, sideways and upward, so that all of its text is
 * seen [pixels]. */
const POINTER_MARGIN = [60, 40];

/** Room that the pointer leaves free for a load beside and above the goal [pixels]. */
const POINTER_ROOM = [70, 90];

/** Distance of the middle of a label from the pointer, sideways and upward, at which they do not overlap
 * [pixels]. */
const POINTER_SIZE = [80, 46];

/** Room that a label of a distance takes [pixels]. */
const LABEL_SIZE = [34, 18];

/** Name of the task that is none. */
const NO_TASK = "free";

/** What an operator has to do without a task. */
const NO_TASK_TEXT = "Move the load with the sticks below, and watch it swing.";

const DEGREES = 180 / Math.PI;

/** Letters of coordinates by their symbols. */
const GREEK = /** @type {Record<string, string>} */ ({gamma: "γ", phi: "φ", theta: "θ"});

/** @param {string} id @returns {any} */
const byId = id => document.getElementById(id);

/** Element with properties and children. @param {string} tag @param {Record<string, unknown>} properties
 * @param {(Node | string)[]} children @returns {any} */
function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

/** Change the text of an element. The same text again would have it laid out and drawn again. @param {Element} element @param {string} text */
function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Move an element to a place in the window [pixels], if it is not there.
 * @param {any} element @param {number} x @param {number} y */
function setPlace(element, x, y) {
  const place = `${x.toFixed(0)}px ${y.toFixed(0)}px`;
  if (element.style.translate !== place) element.style.translate = place;
}

/** Number with some digits after the point. @param {number | null | undefined} value
 * @param {number} digits */
const fixed = (value, digits) => value == null ? "–"
  : value.toFixed(digits).replace(/^-(?=[0.]*$)/, "").replace("-", "−");

/** The smallest of 1, 2, 5, 10, 20, ... that is no smaller than a value, or less than 3 % smaller: a
 * curve may reach that much beyond its axis. @param {number} value */
function roundUp(value) {
  const power = 10 ** Math.floor(Math.log10(value) + 1e-9);
  const digit = [1, 2, 5].find(x => x * power >= value * 0.97) ?? 10;
  return Number((digit * power).toPrecision(1)); // the product has round-off
}

const STRIP_FONT = "11px system-ui, sans-serif";

/** Room that the time of a mark takes [pixels]. */
const MARK_WIDTH = 36;

/** Between two names of a legend [pixels]. */
const LEGEND_GAP = 10;

/** Width of a legend with the gap before it [pixels].
 * @param {CanvasRenderingContext2D} pen @param {Curve[]} curves */
const legendWidth = (pen, curves) => curves.reduce((sum, {label}) => sum + LEGEND_GAP + pen.measureText(label).width, 0);

/** Plots over the last 30 s of simulated time, one below the other. */
class Strips {
  /** @param {HTMLCanvasElement} canvas @param {Plot[]} plots */
  constructor(canvas, plots) {
    this.canvas = canvas;
    this.plots = plots;
    this.columns = 1 + plots.reduce((sum, plot) => sum + plot.curves.length, 0);
    /** Rows of time and values, the oldest first. */
    this.rows = new Float64Array(STRIP_ROWS * this.columns);
    this.count = 0;
  }

  /** Keep a row if the last is old enough. @param {number[]} row Time [s] and values. */
  push(row) {
    const {rows, columns} = this;
    const last = this.count ? rows[(this.count - 1) * columns] : -Infinity;
    // Time runs back where a new run begins. Twenty rows are to spare, since rows come late.
    if (row[0] < last) this.count = 0;
    else if (row[0] - last < STRIP_SECONDS / (STRIP_ROWS - 20)) return;
    if (this.count === STRIP_ROWS) {
      // The oldest row goes.
      rows.copyWithin(0, columns, columns * this.count);
      this.count -= 1;
    }
    rows.set(row, this.count * columns);
    this.count += 1;
  }

  /** Times [s] at which a column passes zero upward. @param {number} column */
  crossings(column) {
    const {rows, columns: n} = this, times = [];
    for (let i = 1; i < this.count; i++) {
      const a = rows[(i - 1) * n + column], b = rows[i * n + column], t = rows[(i - 1) * n];
      if (a < 0 && b >= 0) times.push(t + a / (a - b) * (rows[i * n] - t));
    }
    return times;
  }

  /** Draw all plots. @param {boolean} marks Whether zeros of the first curve are marked. */
  draw(marks) {
    const {canvas, rows, columns, count} = this, ratio = window.devicePixelRatio || 1;
    const {clientWidth: width, clientHeight: height} = canvas, pen = canvas.getContext("2d");
    if (!pen || !width) return;
    [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
    const style = getComputedStyle(document.documentElement);
    const [ink, soft, line] = ["--ink", "--soft", "--line"].map(name => style.getPropertyValue(name));
    const now = count ? rows[(count - 1) * columns] : 0, begin = now - STRIP_SECONDS;
    const left = 36, right = width - 2, each = (height - 16) / this.plots.length;
    // Where a legend does not fit beside its title, all have a line of their own.
    pen.font = STRIP_FONT;
    const lines = Math.max(...this.plots.map(({title, unit, curves}) => legendWidth(pen, curves)
      + pen.measureText(`${title} [${unit}]`).width > right - left ? 2 : 1));
    const index = Array.from({length: count}, (_, i) => i * columns).filter(i => rows[i] >= begin);
    /** @param {number} t */
    const across = t => left + (t - begin) / STRIP_SECONDS * (right - left);
    /** @param {string} text @param {number} x @param {number} y @param {string} colour
     * @param {CanvasTextAlign} align */
    const write = (text, x, y, colour, align) => {
      [pen.fillStyle, pen.textAlign] = [colour, align];
      pen.fillText(text, align === "center" ? Math.min(x, right - 14) : x, y);
    };
    /** @param {number[][]} points @param {string} colour @param {number} width @param {number[]} dash */
    const trace = (points, colour, width = 1, dash = []) => {
      [pen.strokeStyle, pen.lineWidth] = [colour, width];
      pen.setLineDash(dash);
      pen.beginPath();
      for (const [x, y] of points) pen.lineTo(x, y);
      pen.stroke();
    };
    pen.scale(ratio, ratio);
    pen.font = STRIP_FONT;
    let column = 1;
    this.plots.forEach(({title, unit, least, curves}, k) => {
      const top = k * each + 5 + 13 * lines, bottom = (k + 1) * each - 4, middle = (top + bottom) / 2;
      const values = curves.map((_, c) => index.map(i => rows[i + column + c]));
      const most = roundUp(Math.max(least, ...values.flat().map(Math.abs)));
      /** @param {number} y */
      const down = y => middle - y / most * (bottom - top) / 2;
      for (const y of [-most, 0, most]) {
        trace([left, right].map(x => [x, Math.round(down(y)) + 0.5]), line);
        write(`${y}`.replace("-", "−"), left - 5, down(y) + 4, soft, "right");
      }
      for (let t = Math.ceil(Math.max(begin, 0) / 10) * 10; t <= now; t += 10) {
        trace([top, bottom].map(y => [across(t), y]), line);
        if (k === this.plots.length - 1) write(`${t} s`, across(t), height - 4, soft, "center");
      }
      write(`${title} [${unit}]`, left, top + 6 - 13 * lines, ink, "left");
      let x = lines > 1 ? left : right - legendWidth(pen, curves);
      for (const {label, colour} of curves) {
        write(label, x, top - 7, colour, "left");
        x += pen.measureText(label).width + LEGEND_GAP;
      }
      curves.forEach(({colour, dash}, c) =>
        trace(index.map((i, n) => [across(rows[i]), down(values[c][n])]), colour, 1.6, dash));
      let written = -Infinity;
      for (const t of marks && k === 0 ? this.crossings(1).filter(t => t > begin) : []) {
        write("▲", across(t), down(0) + 4, curves[0].colour, "center");
        if (across(t) - written < MARK_WIDTH) continue;
        write(t.toFixed(2), across(t), bottom + 3, ink, "center");
        written = across(t);
      }
      column += curves.length;
    });
  }
}

/** The page: one worker, one picture, the operator's hands. */
class Page {
  /** @param {ViewData} data */
  constructor(data) {
    const {crane, colours} = this.data = data;
    /** @type {Look} */
    this.look = {view: "side", night: matchMedia("(prefers-color-scheme: dark)").matches, t: 0,
      goal: null, radius: 1, aim: null};
    this.assist = "none"; this.stopped = this.paused = false;
    /** @type {State | null} */
    this.state = null;
    /** @type {Exercise | undefined} */
    this.task = undefined;
    this._frames = 0;
    const kernel = new Blob([byId("kernel").textContent], {type: "text/javascript"});
    this.worker = new Worker(URL.createObjectURL(kernel));
    this.worker.onmessage = ({data: message}) => this.receive(message);
    this.worker.onerror = ({message}) => this.tell(`The simulation stopped: ${message}`);
    this.worker.postMessage({type: "start", data});
    /** Drives with what a user calls them and measures them by. */
    this.drives = crane.drives.map((i, k) => {
      const {role, name, symbol, kind} = crane.joints[i], turns = kind === "revolute";
      return {label: role || name.replace(/_joint$/, ""), colour: colours[symbol], dash: [], joint: i,
        rate: crane.rates[k], effort: crane.efforts[k], factor: turns ? DEGREES : 60, unit: turns ? "°/s" : "m/min"};
    });
    const swings = crane.swings.slice(0, 2).map((i, k) => {
      const {symbol} = crane.joints[i];
      return {label: GREEK[symbol] ?? symbol, colour: colours[symbol], dash: k ? [5, 3] : []};
    });
    this.strips = new Strips(byId("strips"), [
      {title: "swing", unit: "°", least: 1, curves: swings},
      {title: "speeds", unit: "% of full", least: 100, curves: this.drives},
      {title: "efforts", unit: "% of limit", least: 20, curves: this.drives}]);
    /** What keys and buttons do besides driving, by code. @type {Record<string, () => void>} */
    this.actions = {
      Space: () => this.worker.postMessage({type: "stop", on: (this.stopped = !this.stopped)}),
      KeyV: () => this.view(VIEWS[(VIEWS.indexOf(this.look.view) + 1) % VIEWS.length]),
      KeyN: () => { this.look.night = !this.look.night; },
      KeyP: () => { this.paused = !this.paused; this.pace(); },
      KeyH: () => byId("keys").showModal(),
      Backspace: () => this.worker.postMessage({type: "reset"}),
      more: () => byId("transport").classList.toggle("more"),
      save: () => this.worker.postMessage({type: "save", file: "drive.csv"}),
      save_inputs: () => this.worker.postMessage({type: "save", file: "drive.json"}),
    };
    this._arrange();
    this.hands = new Hands(crane.drives.map(i => crane.joints[i]), crane.rope?.hoist,
      [byId("stick_0"), byId("stick_1")], code => this.act(code));
    this._nameHands();
    const canvas = byId("scene");
    canvas.addEventListener("webglcontextlost", (/** @type {Event} */ event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => this._open(canvas));
    this._watchPointer(canvas);
    this._open(canvas);
    const first = data.tasks.find(({goal}) => goal);
    if (first) this.begin(first);
    this.show();
    this.pace();
    this._watchSize();
    this._frame = this._frame.bind(this);
    requestAnimationFrame(this._frame);
  }

  /** Open the picture. @param {HTMLCanvasElement} canvas */
  _open(canvas) {
    try {
      this.scene = new Scene(canvas, this.data);
      this._build();
      this._measureFree();
    } catch (error) {
      this.tell(/** @type {Error} */ (error).message, Infinity);
    }
  }

  /** Show the obstacles of the task, or else of the site. */
  _build() {
    this.scene?.build(this.task?.solids ?? this.data.site?.solids ?? []);
  }

  /** Do what a key stands for; return whether it stands for something. @param {string} code */
  act(code) {
    this.actions[code]?.();
    this.show();
    return code in this.actions;
  }

  /** Fill the page with this crane's drives, assistances, sliders and tasks. */
  _arrange() {
    const {data, actions} = this;
    document.title = `${data.title} · cranedyn drive`;
    byId("title").textContent = data.title;
    /** @param {string} id @param {string} code @param {string} text @param {string} value
     * @param {string} title */
    const choice = (id, code, text, value, title = "") =>
      byId(id).append(element("button", {name: code, textContent: text, value, title}));
    data.assistances.forEach(({name, label, text}, i) => {
      actions[`Digit${i + 1}`] = () => this.worker.postMessage({type: "assist", name: (this.assist = name)});
      choice("assistances", `Digit${i + 1}`, label, name, `${text} (${i + 1})`);
    });
    for (const name of VIEWS) {
      actions[name] = () => this.view(name);
      choice("views", name, name, name);
    }
    actions[NO_TASK] = () => this.begin(undefined);
    choice("task_list", NO_TASK, "Just drive", NO_TASK);
    for (const task of data.tasks) {
      actions[task.name] = () => this.begin(task);
      choice("task_list", task.name, task.title, task.name);
    }
    const tonne = 1000 * data.crane.gravity, turning = data.crane.joints.some(({role}) => role === "slew");
    const rows = /** @type {[string, string, number, (state: State) => number | null, string?][]} */ ([
      ["height of load", "m", 2, state => state.height],
      ...data.assist.hoist < 0 ? [] : [["cable l", "m", 2,
        (/** @type {State} */ state) => state.q[data.crane.drives[data.assist.hoist]]]],
      ...data.crane.rope ? [["rope force", "kN", 2, (/** @type {State} */ state) =>
        state.rope_force && state.rope_force / 1000]] : [],
      ...turning ? [["radius", "m", 2, (/** @type {State} */ state) => state.radius],
        ...data.crane.rope ? [["load moment", "t m", 1, (/** @type {State} */ state) =>
          state.rope_force && state.rope_force / tonne * state.radius]] : []] : [],
      ...data.chart ? [["of the chart", "%", 0,
        (/** @type {State} */ state) => state.utilisation && 100 * state.utilisation]] : [],
      ...this.drives.map(({label, unit, factor, joint, colour}) =>
        [label, unit, 1, (/** @type {State} */ state) => factor * state.v[joint], colour])]);
    this.numbers = rows.map(([label, unit, digits, value, colour]) => {
      const cell = element("td"), heading = element("th", {}, label);
      if (colour) heading.prepend(element("i", {style: `background: ${colour}`}));
      byId("numbers").append(element("tr", {}, heading, cell, element("td", {}, unit)));
      return {cell, digits, value};
    });
    for (const {name, label, unit, least, most, value} of data.sliders) {
      const range = element("input", {id: name, type: "range", min: least, max: most, step: "any", value});
      const output = element("output");
      range.oninput = (/** @type {Event | undefined} */ event) => {
        output.textContent = `${Number(range.valueAsNumber.toPrecision(3))} ${unit}`;
        if (event) this.worker.postMessage({type: "slider", name, value: range.valueAsNumber});
      };
      range.oninput();
      byId("sliders").append(element("label", {}, label, output, range));
    }
    byId("tasks").hidden = !data.tasks.length;
    byId("lesson").hidden = data.crane.joints.every(({role}) => role !== "hoist");
    byId("sign_help").hidden = data.crane.joints.every(({symbol}) => symbol !== "phi");
    byId("goal_help").hidden = data.assistances.every(({name}) => name !== "predictive");
    if (innerWidth <= NARROW) byId("reading").open = byId("charts").open = false;
    if (innerHeight <= LOW) byId("tasks").open = false;
    for (const panel of byId("panels").querySelectorAll("details")) {
      panel.ontoggle = () => {
        if (!panel.open || innerWidth > NARROW) return;
        for (const other of byId("panels").querySelectorAll("details[open]")) other.open = other === panel;
      };
    }
    const reach = Math.max(20, ...data.crane.joints.map(({role, upper}) => role === "trolley" ? 1.3 * upper : 0));
    this.labels = [10, 20, 30, 40].filter(r => r <= reach).flatMap(r => [[0, -r], [r, 0], [-r, 0], [0, r]]
      .map(([x, y]) => ({point: [x, y, data.crane.ground], span: element("span", {}, `${r} m`)})));
    byId("labels").append(...this.labels.map(({span}) => span));
    document.addEventListener("click", event => {
      const target = /** @type {HTMLElement} */ (event.target), button = target.closest("button");
      if (button) this.act(button.name);
      // What a pointer has set gives the keys back to the crane.
      if (event.detail) /** @type {any} */ (target.closest("button, summary"))?.blur();
    });
    addEventListener("pointerup", () => /** @type {any} */ (document.activeElement)?.matches("[type=range]")
      && /** @type {any} */ (document.activeElement).blur());
    document.addEventListener("visibilitychange", () => this.pace());
    byId("speed").oninput = () => this.pace();
    byId("load").onchange = () => this._replay(byId("load"));
    byId("period_form").onsubmit = (/** @type {Event} */ event) => {
      event.preventDefault();
      this.judgePeriod(Number(byId("period").value.replace(",", ".")));
    };
  }

  /** Name the drives below the sticks and in the help, with the keys or the ways of a finger. */
  _nameHands() {
    const {hands: {order}, drives, data: {crane}} = this, touch = matchMedia("(pointer: coarse)").matches;
    document.documentElement.classList.toggle("touch", touch);
    const keys = ["← →", "↑ ↓", "R F", "Q E"], ways = ["↔", "↕", "↕", "↔"];
    const kinds = ["slew", "trolley", "hoist"], senses = ["left, right", "out, in", "up, down"];
    const sticks = ["left stick across", "left stick along", "right stick along", "right stick across"];
    /** Name of the drive of an axis, with how it is moved; nothing where there is none. @param {number} axis */
    const caption = axis => order[axis] < 0 ? [] : [`${(touch ? ways : keys)[axis]} ${drives[order[axis]].label}`];
    byId("name_0").textContent = [0, 1].flatMap(caption).join(" · ");
    byId("name_1").textContent = [3, 2].flatMap(caption).join(" · ");
    [[0, 1], [3, 2]].forEach(([across, along], i) => {
      const stick = byId(`stick_${i}`);
      stick.classList.toggle("across", order[across] >= 0);
      stick.classList.toggle("along", order[along] >= 0);
      stick.parentElement.hidden = order[across] < 0 && order[along] < 0;
    });
    order.forEach((drive, axis) => {
      if (drive < 0) return;
      const {role} = crane.joints[crane.drives[drive]], up = axis === 2 && drive === crane.rope?.hoist;
      const sense = up ? senses[2] : senses[kinds.indexOf(role)] ?? "to and fro";
      byId("drive_help").append(element("tr", {}, element("th", {}, `${drives[drive].label} ${sense}`),
        element("td", {className: "keyboard"}, ...keys[axis].split(" ").flatMap(key => [element("kbd", {}, key), " "])),
        element("td", {}, sticks[axis])));
    });
  }

  /** Let the pointer turn and zoom the picture, and a click set the goal.
   * @param {HTMLCanvasElement} canvas */
  _watchPointer(canvas) {
    let moved = 0;
    /** Where pointers are that hold the picture [pixels]. @type {Map<number, number[]>} */
    const held = new Map();
    /** Distance of two fingers [pixels]. */
    const spread = () => {
      const [[x, y], [u, v]] = held.values();
      return Math.hypot(x - u, y - v);
    };
    canvas.onpointerdown = ({pointerId, clientX, clientY}) => {
      moved = 0;
      held.set(pointerId, [clientX, clientY]);
      canvas.setPointerCapture(pointerId);
    };
    canvas.onlostpointercapture = ({pointerId}) => { held.delete(pointerId); };
    canvas.onpointermove = ({pointerId, clientX, clientY, movementX, movementY}) => {
      if (!canvas.hasPointerCapture(pointerId)) return;
      moved += Math.hypot(movementX, movementY);
      const before = held.size === 2 ? spread() : 0;
      held.set(pointerId, [clientX, clientY]);
      if (held.size === 2) {
        // Fingers that spread to twice their distance bring the eye to half of its own.
        this.scene?.zoom(before / Math.max(spread(), 1));
        return;
      }
      if (moved < 6) return;
      if (this.look.view !== "orbit") this.act("orbit");
      this.scene?.turn(movementX, movementY);
    };
    canvas.onpointerup = ({clientX, clientY}) => {
      const {scene} = this;
      if (moved >= 6 || this.assist !== "predictive" || !this.state || !scene) return;
      const point = scene.pick(clientX, clientY);
      if (!point) return;
      const {position, place} = scene.reachFor(this.state.q, [point[0], point[1], scene.load[2]]);
      this.look.aim = place;
      this.worker.postMessage({type: "goal", position});
    };
    canvas.addEventListener("wheel", event => {
      event.preventDefault();
      this.scene?.zoom(Math.exp(0.001 * event.deltaY));
    }, {passive: false});
  }

  /** Choose a view, if the task allows it. @param {string} name */
  view(name) {
    if (this.task?.blind && name !== "cabin") this.tell("In this task the cabin is the only view.");
    else this.look.view = name;
  }

  /** Send the speed; a page that nobody sees stands still. */
  pace() {
    const factor = this.paused || document.hidden ? 0 : byId("speed").valueAsNumber;
    this.worker.postMessage({type: "speed", factor});
  }

  /** Begin a task, or drive without one. @param {Exercise | undefined} task */
  begin(task) {
    if (task?.blind) this.look.view = "cabin";
    else if (this.task?.blind) this.look.view = "side";
    this.task = task;
    this.look.goal = task?.goal ?? null;
    this.look.radius = task?.radius ?? 0;
    this._build();
    this.worker.postMessage({type: "task", name: task?.name ?? null});
  }

  /** Measure the part of the picture that panels leave free, now and whenever they change. */
  _watchSize() {
    const panels = ["top", "left", "right", "transport"].map(byId);
    const watcher = new ResizeObserver(() => this._measureFree());
    for (const panel of [...panels, ...document.querySelectorAll("#messages, #panels details > div")]) {
      watcher.observe(panel);
    }
    addEventListener("resize", () => this._measureFree());
    this._measureFree();
  }

  /** Measure the part of the picture that panels leave free. */
  _measureFree() {
    /** @param {Element} element */
    const box = element => element.getBoundingClientRect();
    const wide = innerWidth > NARROW, footer = box(byId("transport"));
    const above = wide ? ["messages"].map(byId) : [byId("top"), ...document.querySelectorAll("#panels details[open] > div")];
    let top = Math.max(...above.map(panel => box(panel).bottom)), bottom = footer.top;
    const left = wide ? box(byId("left")).right : 0, right = wide ? box(byId("right")).left : innerWidth;
    const covered = bottom - top < LEAST_FREE * innerHeight;
    /** Free part of the window, in which pointer and labels are [pixels]; null where panels lie on the
     * picture. */
    this.free = covered ? null : {left, right, top, bottom};
    if (covered) [top, bottom] = [0, innerHeight];
    if (!this.scene) return;
    this.scene.nextFree = {x: (left + right) / innerWidth - 1, y: 1 - (top + bottom) / innerHeight,
      halfWidth: (right - left) / innerWidth, halfHeight: (bottom - top) / innerHeight};
  }

  /** Point to the goal: from above where it is seen, or from below where the load is above it, and else
   * from the edge of the picture's free part.
   * @param {State | null} state */
  _pointToGoal(state) {
    const {scene, look: {goal, radius}, free, task} = this, pointer = byId("pointer");
    const hidden = !scene || !goal || !free || !state || state.task?.done === true || !task;
    if (pointer.hidden !== hidden) pointer.hidden = hidden;
    /** Where the pointer is in the window [pixels]; null where there is none. @type {number[] | null} */
    this.pointed = null;
    if (hidden || !scene || !goal || !free) return;
    const [x, y] = scene.wayTo(goal);
    const [halfWidth, halfHeight] = [free.right - free.left, free.bottom - free.top].map((size, k) =>
      size / 2 - POINTER_MARGIN[k]);
    const share = Math.min(1, halfWidth / Math.abs(x), halfHeight / Math.abs(y)), seen = share === 1;
    const distance = Math.hypot(...goal.map((place, k) => place - scene.load[k]));
    const [loadX, loadY] = scene.wayTo(scene.load), [width, height] = POINTER_ROOM;
    const below = seen && Math.abs(loadX - x) < width && y - loadY < height && loadY - y < POINTER_DISTANCE
      && y + 2 * POINTER_DISTANCE < halfHeight;
    const [arrow, text] = pointer.children;
    const rotation = `${(below ? -90 : seen ? 90 : Math.atan2(y, x) * DEGREES).toFixed(0)}deg`;
    if (arrow.style.rotate !== rotation) arrow.style.rotate = rotation;
    pointer.classList.toggle("below", below);
    setText(text, distance > radius ? `target ${fixed(distance, distance < 10 ? 1 : 0)} m` : "hold it still");
    const left = (free.left + free.right) / 2 + share * x;
    const top = (free.top + free.bottom) / 2 + share * y - (below ? -POINTER_DISTANCE : seen ? POINTER_DISTANCE : 0);
    setPlace(pointer, left, top);
    this.pointed = [left, top];
  }

  /** Drive recorded inputs again. @param {HTMLInputElement} chooser */
  async _replay(chooser) {
    try {
      const {crane, inputs} = JSON.parse(await /** @type {FileList} */ (chooser.files)[0].text());
      if (JSON.stringify(crane) !== JSON.stringify(this.data.crane.record)) {
        this.tell("This file holds a drive of another crane; allowed is one of this page's.");
      } else this.worker.postMessage({type: "replay", inputs});
    } catch {
      this.tell("This file holds no inputs of a drive; allowed is a .json file that “Save inputs” wrote.");
    }
    chooser.value = "";
  }

  /** Compare a measured period with the closed form. @param {number} measured [s] */
  judgePeriod(measured) {
    const {crane} = this.data, hoist = crane.joints.findIndex(joint => joint.role === "hoist");
    const l = (this.state?.q ?? crane.start)[hoist], closed = 2 * Math.PI * Math.sqrt(l / crane.gravity);
    const error = 100 * (measured / closed - 1), side = error < 0 ? "shorter" : "longer";
    byId("period_answer").textContent = measured > 0 ? `2π√(l/g) at l = ${fixed(l, 2)} m: ${fixed(closed, 3)} s.
      Yours is ${fixed(Math.abs(error), 2)} % ${side}.${error > 0 && error < 2 ? ` The load's own inertia, the size
      of the swing and reading the marks make it longer.` : ""}` : "Enter a time in seconds.";
  }

  /** Take a message of the worker. @param {any} message */
  receive(message) {
    if (message.type === "saved") download(message.file, message.blob);
    else if (message.type === "refused") this.tell(message.text);
    else if (message.type === "state") {
      const state = /** @type {State} */ (message), before = this.state;
      this.state = state;
      if (state.event) this.tell(`${state.event.text} Press Reset to go on.`, Infinity);
      else if (before?.event) this.tell("");
      if (state.assist !== this.assist || state.stopped !== this.stopped) {
        [this.assist, this.stopped] = [state.assist, state.stopped];
        this.show();
      }
      if (!state.goal || state.t < (before?.t ?? 0)) this.look.aim = null;
      const {crane} = this.data;
      this.strips.push([state.t,
        ...crane.swings.slice(0, 2).map((i, k) => (state.q[i] - hangingAngle(crane, k, state.q)) * DEGREES),
        ...this.drives.map(({joint, rate}) => 100 * state.v[joint] / rate),
        ...this.drives.map(({effort}, i) => 100 * state.effort[i] / effort)]);
    }
  }

  /** Show a sentence for some seconds. @param {string} text @param {number} seconds */
  tell(text, seconds = NOTICE_SECONDS) {
    byId("event").textContent = text;
    this._until = performance.now() + 1000 * seconds;
  }

  /** Show what is chosen. */
  show() {
    const {look, data, task} = this, root = document.documentElement;
    for (const [id, value] of Object.entries({assistances: this.assist, views: look.view,
      task_list: task?.name ?? NO_TASK})) {
      for (const button of byId(id).children) button.setAttribute("aria-pressed", button.value === value);
    }
    root.classList.toggle("night", look.night);
    root.classList.toggle("stopped", this.stopped);
    root.classList.toggle("aiming", this.assist === "predictive");
    byId("stop").setAttribute("aria-pressed", this.stopped);
    byId("stop").textContent = this.stopped ? "RELEASE" : "STOP";
    byId("night").textContent = look.night ? "☀" : "☾";
    byId("pause").textContent = this.paused ? "▶" : "❚❚";
    byId("explanation").textContent = data.assistances.find(({name}) => name === this.assist)?.text;
    byId("task_text").textContent = task?.text ?? NO_TASK_TEXT;
    byId("score").hidden = !task;
    byId("no_score").textContent = task?.no_best ? `The planner has no score. ${task.no_best}` : "";
    byId("more").setAttribute("aria-expanded", byId("transport").classList.contains("more"));
  }

  /** Write the numbers. @param {State} state */
  _write(state) {
    setText(byId("swing").firstElementChild, `${fixed(state.swing * DEGREES, 1)}°`);
    for (const {cell, digits, value} of this.numbers ?? []) setText(cell, fixed(value(state), digits));
    const cable = byId("cable");
    if (cable && !cable.matches(":active")) {
      cable.value = state.cable ?? state.q[this.data.crane.drives[this.data.assist.hoist]];
      cable.oninput();
    }
    setText(byId("clock"), `${state.replaying ? "replay " : ""}${fixed(state.t, 1)} s`);
    setText(byId("ratio"), `× ${this.paused ? 0 : byId("speed").value}`);
    byId("ratio").title = `reached: × ${fixed(state.ratio, 1)}`;
    const mine = state.task, best = this.task?.best;
    if (!mine || mine.name !== this.task?.name) return;
    const rows = [["", "you"], ["time [s]", fixed(mine.time, 1)],
      ["largest swing [°]", fixed(mine.largest_swing * DEGREES, 1)], ["energy [kJ]", fixed(mine.energy / 1000, 1)]];
    const planned = best ? ["planner", fixed(best.time, 1), fixed(best.swing * DEGREES, 1),
      fixed(best.energy / 1000, 1)] : [];
    const score = byId("score"), columns = best ? 3 : 2;
    if (score.rows.length !== rows.length || score.rows[0].cells.length !== columns) {
      score.replaceChildren(...rows.map(() => element("tr", {},
        ...Array.from({length: columns}, (_, i) => element(i ? "td" : "th")))));
    }
    rows.forEach((row, k) => [...row, ...planned.slice(k, k + 1)].forEach((text, i) =>
      setText(score.rows[k].cells[i], text)));
    if (mine.done) {
      setText(byId("task_text"), `Done in ${fixed(mine.time, 1)} s. Choose another task, or press Reset to do it again.`);
    }
  }

  /** Place the labels of distances on the ground where they are seen and overlap neither each other nor
   * the pointer. */
  _placeLabels() {
    const {scene, free, pointed, labels = []} = this, taken = /** @type {number[][]} */ ([]);
    /** Whether a label would be on the pointer. @param {number[]} place */
    const onPointer = place => pointed && Math.abs(place[0] + LABEL_SIZE[0] / 2 - pointed[0]) < POINTER_SIZE[0]
      && Math.abs(place[1] + LABEL_SIZE[1] / 2 - pointed[1]) < POINTER_SIZE[1];
    for (const {point, span} of labels) {
      const place = scene?.project(point);
      const shown = place && free && place[0] > free.left && place[0] < free.right - LABEL_SIZE[0]
        && place[1] > free.top && place[1] < free.bottom - LABEL_SIZE[1] && !onPointer(place)
        && taken.every(([x, y]) => Math.abs(x - place[0]) > LABEL_SIZE[0] || Math.abs(y - place[1]) > LABEL_SIZE[1]);
      if (span.hidden !== !shown) span.hidden = !shown;
      if (!place || !shown) continue;
      taken.push(place);
      setPlace(span, place[0], place[1]);
    }
  }

  /** Draw one picture, and now and then the rest. */
  _frame() {
    const {state, look, scene} = this;
    this.worker.postMessage({type: "sticks", values: this.hands.sticks()});
    look.t = state?.t ?? 0;
    scene?.draw(state?.q ?? this.data.crane.start, look);
    this._pointToGoal(state);
    this._placeLabels();
    if (state && this._frames++ % 3 === 0) {
      this._write(state);
      this.strips.draw(byId("lesson").open || this.assist === "none");
    }
    if (performance.now() > (this._until ?? 0)) setText(byId("event"), "");
    requestAnimationFrame(this._frame);
  }
}

/** Offer a file. @param {string} name @param {Blob} blob */
function download(name, blob) {
  const link = element("a", {href: URL.createObjectURL(blob), download: name});
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

const page = new Page(JSON.parse(byId("data").textContent));
