"use strict";

/**
 * @typedef {[number, string, any]} Input Control instant, what changes, and its new value.
 *
 * @typedef {Object} Part A convex body of an obstacle.
 * @property {string} name Of the obstacle.
 * @property {number[][]} corners [m]
 * @property {number[][]} faces Outward normal and offset: normal · p = offset on the face.
 * @property {number[][]} edges Directions of its edges.
 *
 * @typedef {Object} TaskData
 * @property {string} name
 * @property {string} title
 * @property {string} text
 * @property {number[]} state Coordinates and rates at the start.
 * @property {number[] | null} goal Where the load is to be [m]; null for anywhere.
 * @property {number} radius Allowed distance from there [m].
 * @property {number} swing Allowed swing [rad].
 * @property {Part[] | null} parts Obstacles of the task; null for those of the site.
 *
 * @typedef {Object} CraneData
 * @property {JointData[]} joints
 * @property {number[]} drives
 * @property {{joint: number, point: number[]}[]} points Rope from the pivot to the load.
 * @property {number[]} order Place of each of them among the points that forces act on.
 * @property {number[]} rest Where the swing joints hang with all drives at 0, by joint [rad].
 * @property {number[][]} rest_slope Change of these angles, by swing, with the position of each drive.
 * @property {number[]} swings Joints of the swing.
 * @property {number[]} damping By joint.
 * @property {({effort: number, width: number} | null)[]} friction Dry friction by joint.
 * @property {number[][]} load Corners of the load in the frame of its joint [m].
 * @property {{hoist: number, sign: number} | null} rope Drive of a rigid rope, and 1 if the rope grows
 *   longer with its coordinate, else -1.
 * @property {number} lead Time by which positions run ahead of rates [s].
 * @property {Record<string, string[]>} columns
 * @property {object} record What `load_crane` loads the crane from.
 * @property {number} gravity
 *
 * @typedef {Object} PageData
 * @property {CraneData} crane
 * @property {AssistData} assist
 * @property {KernelData} kernel
 * @property {Part[]} parts Obstacles of the site.
 * @property {TaskData[]} tasks
 * @property {{name: string, value: number, least: number, most: number}[]} sliders
 * @property {{name: string}[]} assistances
 * @property {{least: number, radii: number[], rated: number[]} | null} chart Rated load [kg] over
 *   radius [m] from the least radius on.
 * @property {number} drag Half the density of air times drag coefficient and area of the load.
 */

/** Time for which a load must hang still in its goal before a task is done [s]. */
const STILL_SECONDS = 2;

/** Share of the range of a drive that goals of predictive control keep from each end: closer to an
 * end the controller makes the load swing. */
const GOAL_MARGIN_RATIO = 0.02;

/** Largest position of a goal, as of the inputs of exported blocks. */
const LARGEST = 1e12;

/** One run of the crane, from its start on: the same inputs at the same control instants make the
 * same motion to the bit. */
class Run {
  /** @param {PageData} data @param {Awaited<ReturnType<typeof compile>>} code */
  constructor(data, code) {
    this.data = data;
    this.crane = data.crane;
    this.kernel = new Kernel(data.kernel, code);
    this.kinematics = new Kinematics(data.crane.joints);
    this.assistant = new Assistant(data.assist, data.crane.joints, data.kernel.period);
    this.k = 0;
    /** @type {Input[]} */
    this.inputs = [];
    this.sticks = data.crane.drives.map(() => 0);
    this.assist = "none";
    this.stopped = false;
    /** @type {Record<string, number>} */
    this.sliders = Object.fromEntries(data.sliders.map(slider => [slider.name, slider.value]));
    this.usual = {...this.sliders};
    /** @type {number | null} Length to which the hoist goes [m]; null for where its stick says. */
    this.cable = null;
    /** @type {string | null} Why the run has ended. */
    this.event = null;
    /** @type {(TaskData & {time: number, largest: number, still: number, energy: number, done: boolean}) | null} */
    this.task = null;
    this.parts = data.parts;
    this.work = data.crane.drives.map(() => 0);
    this.dissipated = 0;
    this.forceWork = 0;
    this.valid = true;
    this._before = {effort: [0], middle: [0], power: 0, force: [0, 0, 0], load: [0, 0, 0]};
    this.assistant.begin(this.kernel.q, this.kernel.v);
    this.goTo(this.driven());
    /** Where the ramps of the converters would have taken the drives. */
    this.asked = this.driven();
    this.setpoint = this.asked;
    /** @type {number | null} Tension of the rope [N]; null where it is not known. */
    this.tension = null;
    /** @type {number[][]} Rope in the world, from the pivot to the load [m]. */
    this.points = [];
    /** @type {{q: number[], v: number[], force: number[]}} */
    this.state = {q: [], v: [], force: []};
    this.look();
  }

  /** Keep where the crane is now, and how it moves, for the messages to the page. */
  look() {
    const {q, v, force} = this.kernel;
    this.kinematics.move(q);
    this.points = this.rope();
    this.state = {q: Array.from(q), v: Array.from(v), force: Array.from(force)};
  }

  /** Positions of the drives. */
  driven() {
    return this.crane.drives.map(joint => this.kernel.q[joint]);
  }

  /** Time [s]. */
  get t() {
    return this.k * this.data.kernel.period;
  }

  /** Change something from this control instant on. @param {string} kind @param {any} value */
  input(kind, value) {
    const reason = inputRefusal(this.data, kind, value);
    if (reason !== null) {
      this.event = reason;
      return;
    }
    this.inputs.push([this.k, kind, value]);
    if (kind === "sticks") {
      this.sticks = value;
      if (value[this.data.assist.hoist]) this.cable = null;
    } else if (kind === "stop") [this.stopped, this.cable] = [value, null];
    else if (kind === "goal") this.goTo(value);
    else if (kind === "slider") this.slide(value[0], value[1]);
    else if (kind === "task") this.begin(value);
    else if (kind === "assist") {
      this.assist = value;
      this.assistant.begin(this.kernel.q, this.kernel.v);
      if (value === "predictive") {
        this.goTo(this.driven());
        this.kernel.beginPlanning(this.assistant.ramps);
      }
    }
  }

  /** @param {number[]} goal Positions of the drives. */
  goTo(goal) {
    const {joints, drives} = this.crane;
    this.kernel.goal.set(goal.map((position, i) => {
      const {lower, upper} = joints[drives[i]];
      const margin = GOAL_MARGIN_RATIO * (upper - lower);
      return Math.min(Math.max(position, lower + margin), upper - margin);
    }));
  }

  /** @param {string} name @param {number} value */
  slide(name, value) {
    this.sliders[name] = value;
    if (name === "cable") {
      this.cable = this.stopped ? null : value;
      const goal = Array.from(this.kernel.goal);
      goal[this.data.assist.hoist] = value;
      this.goTo(goal);
      return;
    }
    this.vary();
  }

  /** Give the crane the numbers of the sliders, in which they are affine: the usual ones, plus the
   * change by a unit of each slider times its distance from where it usually stands. */
  vary() {
    const {sliders, data: {kernel: {numbers, variations}}} = this;
    this.assistant.ramps = sliders.ramp / this.usual.ramp;
    this.kernel.setRamps(this.assistant.ramps);
    this.kernel.numbers.set(numbers.map((number, i) => Object.entries(variations).reduce(
      (sum, [slider, per]) => sum + (sliders[slider] - this.usual[slider]) * per[i], number)));
  }

  /** @param {string | null} name Of a task; null for none. */
  begin(name) {
    const task = this.data.tasks.find(candidate => candidate.name === name);
    this.task = task ? {...task, time: 0, largest: 0, still: 0, energy: 0, done: false} : null;
    this.parts = task?.parts ?? this.data.parts;
    if (!task) return;
    this.cable = null;
    this.kernel.setState(task.state);
    this.asked = this.driven();
    this.assistant.begin(this.kernel.q, this.kernel.v);
    this.goTo(this.driven());
    this.look();
  }

  /** Points of the rope in the world, from the pivot to the load. */
  rope() {
    return this.crane.points.map(({joint, point}) => this.kinematics.point(joint, point));
  }

  /** Size of the swing from rest [rad]. */
  get swing() {
    const {q} = this.kernel;
    return Math.hypot(...this.crane.swings.map((i, k) => q[i] - hangingAngle(this.crane, k, q)));
  }

  /** Log a control instant and advance by a control period, unless the run has ended. It ends where
   * the model ceases to hold, or the assistance commands what is not a number. */
  advance() {
    if (this.event !== null) return;
    const {kernel, crane} = this, {q, v} = kernel;
    const planned = this.assist === "predictive" && !this.stopped;
    const sticks = this.stopped ? this.sticks.map(() => 0) : this.sticks;
    const assist = this.stopped ? "none" : this.assist;
    const rates = planned ? this.assistant.limited(kernel.plan(this.k), q)
      : this.assistant.command(assist, sticks, q, v, this.cable);
    if (!rates.every(Number.isFinite)) {
      this.event = "The assistance commanded what is no number.";
      return;
    }
    kernel.command.set(rates);
    this.look();
    const rope = this.points;
    this.state.force = this.blow(rope);
    // Positions run ahead of rates by the lead, in semi-implicit Euler; work is force times the way
    // between positions of the instants of the rates.
    const middle = crane.drives.map(i => q[i] - crane.lead * v[i]);
    const power = crane.damping.reduce((sum, _, i) => sum + resistance(crane, i, v[i]) * v[i], 0);
    const {period} = this.data.kernel;
    this.setpoint = this.asked;
    const before = Array.from(kernel.reference);
    this.valid = kernel.advance();
    this.asked = this.asked.map((x, i) => x + (before[i] + kernel.reference[i]) / 2 * period);
    this.account(middle, power, rope);
    if (crane.rope) {
      const {hoist, sign} = crane.rope, joint = crane.drives[hoist];
      const opposing = resistance(crane, joint, this.state.v[joint]);
      this.tension = sign * (opposing - kernel.row.effort[hoist]);
    } else this.tension = null;
    this.event = this.ended(rope);
    if (this.task) this.judge(rope[rope.length - 1]);
    this.k += 1;
  }

  /** Force of the rope as a share of the rated load at the radius of the trolley; null where there is
   * no chart, the radius is outside of it, or the tension is not known. */
  get utilisation() {
    const {data: {chart}, tension} = this;
    const radius = Math.hypot(this.points[0][0], this.points[0][1]);
    if (!chart || tension === null) return null;
    const {least, radii, rated} = chart;
    const [i, share] = locate(radii, radius);
    if (radius < least || radius > radii[radii.length - 1]) return null;
    // Between two rows of the chart the rated moment, radius times load, is interpolated, and no load
    // is more than that of the row before.
    /** Moment of a row. @param {number} k */
    const moment = k => radii[k] * rated[k];
    const between = moment(i) + (share && share * (moment(i + 1) - moment(i)));
    return tension / this.crane.gravity / Math.min(rated[i], between / radius);
  }

  /** Let the wind act on the load, by the drag of the air that passes it, and return the forces on
   * all points [N]. @param {number[][]} rope */
  blow(rope) {
    const {force} = this.kernel, speed = this.sliders.wind_speed ?? 0;
    force.fill(0);
    if (speed !== 0) {
      const angle = (this.sliders.wind_direction ?? 0) * Math.PI / 180;
      const last = this.crane.points.length - 1, {joint} = this.crane.points[last];
      const moving = this.kinematics.velocity(joint, rope[last], this.kernel.v);
      const air = [speed * Math.cos(angle), speed * Math.sin(angle), 0].map((x, i) => x - moving[i]);
      const size = this.data.drag * Math.hypot(...air);
      air.forEach((x, i) => { force[3 * this.crane.order[last] + i] = size * x; });
    }
    return Array.from(force);
  }

  /** Add up the work of the drives and of the wind and the dissipation since the last control instant,
   * as `simulate` does: the mean force of both instants times the way between.
   * @param {number[]} middle @param {number} power @param {number[][]} rope */
  account(middle, power, rope) {
    const before = this._before, {row, force} = this.kernel, {period} = this.data.kernel;
    const last = rope[rope.length - 1], first = 3 * this.crane.order[rope.length - 1];
    if (this.k > 0) {
      for (let i = 0; i < middle.length; i += 1) {
        this.work[i] += (before.effort[i] + row.before[i]) / 2 * (middle[i] - before.middle[i]);
      }
      this.dissipated += (before.power + power) / 2 * period;
      for (let i = 0; i < 3; i += 1) this.forceWork += before.force[i] * (last[i] - before.load[i]);
    }
    const pushed = [force[first], force[first + 1], force[first + 2]];
    this._before = {effort: Array.from(row.effort), middle, power, force: pushed, load: last};
  }

  /** Why the run ends here, or null. @param {number[][]} rope */
  ended(rope) {
    const {crane} = this, {q} = this.state;
    if (!q.every(Number.isFinite)) return "The motion diverged.";
    for (const i of crane.drives) {
      const {lower, upper, name} = crane.joints[i];
      if (q[i] < lower || q[i] > upper) return `${name} left its range.`;
    }
    if (this.tension !== null && this.tension <= 0) return "The rope went slack.";
    if (this.swing >= Math.PI / 2) return "The load swung to 90°.";
    if (rope[rope.length - 1][2] <= 0) return "The load touched the ground.";
    if (!this.parts.length) return null;
    const {joint} = crane.points[crane.points.length - 1];
    const load = crane.load.map(corner => this.kinematics.point(joint, corner));
    for (const part of this.parts) {
      if (boxMeets(load, part)) return `The load touched ${part.name}.`;
      for (let i = 1; i < rope.length; i += 1) {
        if (segmentMeets(rope[i - 1], rope[i], part)) return `The rope touched ${part.name}.`;
      }
    }
    return null;
  }

  /** Update the score of the task. The load counts as still where its swing [rad], and the rate of
   * that [rad/s], are both no larger than the allowed swing.
   * @param {number[]} load Centre of the load [m]. */
  judge(load) {
    const task = this.task, {period} = this.data.kernel;
    if (!task || task.done) return;
    task.time += period;
    task.largest = Math.max(task.largest, this.swing);
    const {effort} = this.kernel.row, rates = this.crane.drives.map(joint => this.kernel.v[joint]);
    task.energy += Math.max(rates.reduce((sum, v, i) => sum + v * effort[i], 0), 0) * period;
    const {goal} = task;
    const distance = goal ? Math.hypot(...load.map((x, i) => x - goal[i])) : 0;
    const {v} = this.state, {swings, drives, rest_slope} = this.crane;
    const rate = Math.hypot(...swings.map((i, k) =>
      drives.reduce((sum, joint, d) => sum - rest_slope[k][d] * v[joint], v[i])));
    const isStill = this.swing <= task.swing && rate <= task.swing;
    task.still = isStill && distance <= task.radius ? task.still + period : 0;
    task.done = task.still >= STILL_SECONDS;
  }

  /** Values of the columns of the last control instant. */
  values() {
    const {row} = this.kernel;
    const {q, v, force} = this.state;
    return [(this.k - 1) * this.data.kernel.period, ...q, ...v, ...this.setpoint, ...row.command,
      ...row.effort, row.energy[0], ...this.work, this.dissipated, ...force, this.forceWork, 0,
      this.valid ? 1 : 0];
  }
}

/**
 * Effort by which damping and dry friction oppose the rate of a joint [N m or N].
 * @param {CraneData} crane @param {number} joint Index. @param {number} rate [rad/s or m/s].
 */
function resistance(crane, joint, rate) {
  const viscous = crane.damping[joint] * rate, dry = crane.friction[joint];
  return dry ? viscous + dry.effort * (rate / Math.sqrt(rate * rate + dry.width * dry.width)) : viscous;
}

/** Whether a segment meets a convex body. @param {number[]} a @param {number[]} b @param {Part} part */
function segmentMeets(a, b, part) {
  let from = 0, to = 1;
  for (const [x, y, z, offset] of part.faces) {
    const first = x * a[0] + y * a[1] + z * a[2] - offset;
    const last = x * b[0] + y * b[1] + z * b[2] - offset;
    if (first > 0 && last > 0) return false;
    if (first > 0) from = Math.max(from, first / (first - last));
    else if (last > 0) to = Math.min(to, first / (first - last));
  }
  return from <= to;
}

/** Whether a box meets a convex body: no axis separates them (Gottschalk, Lin & Manocha 1996).
 * @param {number[][]} box Its eight corners, the first three neighbours of the fourth.
 * @param {Part} part */
function boxMeets(box, part) {
  const sides = [0, 1, 2].map(i => box[i].map((x, k) => x - box[3][k]));
  const axes = [...part.faces, ...sides, ...sides.flatMap(side => part.edges.map(edge => cross(side, edge)))];
  return axes.every(([x, y, z]) => {
    /** @param {number[][]} points @returns {[number, number]} */
    const shadow = points => {
      const places = points.map(p => x * p[0] + y * p[1] + z * p[2]);
      return [Math.min(...places), Math.max(...places)];
    };
    const [a, b] = shadow(box), [c, d] = shadow(part.corners);
    return a <= d && c <= b;
  });
}

/**
 * Why an input is impossible, or null: a drive to show again is a file that anybody may have written.
 * @param {PageData} data @param {any} kind @param {any} value @returns {string | null}
 */
function inputRefusal(data, kind, value) {
  const count = data.crane.drives.length;
  /** @param {any} x @param {number} least @param {number} most */
  const within = (x, least, most) => typeof x === "number" && x >= least && x <= most;
  /** @param {any} list @param {number} limit */
  const numbers = (list, limit) => Array.isArray(list) && list.length === count
    && list.every(x => within(x, -limit, limit));
  /** @type {Record<string, () => boolean>} */
  const possible = {
    sticks: () => numbers(value, 1),
    goal: () => numbers(value, LARGEST),
    stop: () => typeof value === "boolean",
    assist: () => data.assistances.some(({name}) => name === value),
    task: () => value === null || data.tasks.some(({name}) => name === value),
    slider: () => Array.isArray(value)
      && data.sliders.some(({name, least, most}) => name === value[0] && within(value[1], least, most)),
  };
  const known = typeof kind === "string" && Object.hasOwn(possible, kind);
  return known && possible[kind]() ? null
    : `The input ${String(kind).slice(0, 20)} is impossible: ${String(JSON.stringify(value)).slice(0, 60)}.`;
}

/**
 * Why something is no list of inputs of a drive, or null. A list is taken as a whole or not at all.
 * @param {PageData} data @param {any} inputs @returns {string | null}
 */
function replayRefusal(data, inputs) {
  if (!Array.isArray(inputs)) return "The file has no list of inputs.";
  let last = 0;
  for (const [i, input] of inputs.entries()) {
    const shown = String(JSON.stringify(input)).slice(0, 60);
    if (!Array.isArray(input) || input.length !== 3) {
      return `Input ${i + 1} of the file is ${shown}; allowed is [instant, kind, value].`;
    }
    const [instant, kind, value] = input;
    if (!Number.isSafeInteger(instant) || instant < last) {
      return `The instant of input ${i + 1} of the file, ${shown}, is not a whole number from ${last} on.`;
    }
    const reason = inputRefusal(data, kind, value);
    if (reason !== null) return `Input ${i + 1} of the file: ${reason}`;
    last = instant;
  }
  return null;
}

/**
 * Drive the crane again with recorded inputs.
 * @param {PageData} data @param {Awaited<ReturnType<typeof compile>>} code
 * @param {Input[]} inputs @param {number} instants @param {(run: Run) => void} [each]
 */
function replay(data, code, inputs, instants, each) {
  const run = new Run(data, code);
  let next = 0;
  while (run.k < instants && run.event === null) {
    while (next < inputs.length && inputs[next][0] <= run.k) {
      run.input(inputs[next][1], inputs[next][2]);
      next += 1;
    }
    run.advance();
    if (each) each(run);
  }
  return run;
}
