"use strict";

/** Time between two pictures [ms]. */
const TICK = 1000 / 60;

/** Share of that time in which the motion is computed, at most. */
const MOTION_SHARE = 0.8;

/** Longest time that is made up for after a pause of the page [s]. */
const MAX_PAUSE = 0.25;

/** The crane in real time, or at a multiple of it. */
class Session {
  /** @param {PageData} data @param {Awaited<ReturnType<typeof compile>>} code */
  constructor(data, code) {
    this.data = data;
    this.code = code;
    /** Speed of the crane's time over that of the clock, as asked for. */
    this.factor = 1;
    /** The same as reached, smoothed over some twenty pictures. */
    this.ratio = 0;
    /** @type {Input[]} Inputs to replay, the earliest last. */
    this.waiting = [];
    this.run = new Run(data, code);
    /** Control instants that are due and not yet computed. */
    this.due = 0;
    this.last = performance.now();
    setInterval(() => this.tick(), TICK);
  }

  /** Begin a new run with the sliders, the assistance and the task of the last one. */
  reset() {
    const {sliders, assist, task} = this.run;
    this.run = new Run(this.data, this.code);
    this.waiting = [];
    this.due = 0;
    for (const [name, value] of Object.entries(sliders)) {
      if (name !== "cable" && value !== this.run.usual[name]) this.run.input("slider", [name, value]);
    }
    if (assist !== "none") this.run.input("assist", assist);
    if (task) this.run.input("task", task.name);
  }

  /** Compute the control instants that are due, and send the page where the crane is. */
  tick() {
    const now = performance.now(), {period} = this.data.kernel, {run} = this;
    const passed = Math.min((now - this.last) / 1000, MAX_PAUSE);
    this.last = now;
    if (run.event !== null) return;
    this.due += passed * this.factor / period;
    const first = run.k;
    while (this.due >= 1 && run.event === null && performance.now() - now < MOTION_SHARE * TICK) {
      while (this.waiting.length && this.waiting[this.waiting.length - 1][0] <= run.k) {
        const [, kind, value] = /** @type {Input} */ (this.waiting.pop());
        run.input(kind, value);
      }
      run.advance();
      this.due -= 1;
    }
    this.due = Math.min(this.due, 1);
    if (passed > 0) this.ratio += 0.05 * ((run.k - first) * period / passed - this.ratio);
    if (run.k > first || run.k === 0 || run.event !== null) this.show(run);
  }

  /** Send the page the state of a run. @param {Run} run */
  show(run) {
    const {kernel, task} = run, rope = run.points;
    if (!run.state || !rope) return;
    const load = rope[rope.length - 1], slew = rope[0];
    postMessage({
      type: "state", k: run.k, t: run.t, ...run.state, command: [...kernel.command],
      effort: [...kernel.row.effort], swing: run.swing, height: load[2],
      radius: Math.hypot(slew[0], slew[1]), rope_force: run.tension, energy: kernel.row.energy[0],
      work: run.work.reduce((a, b) => a + b, 0), assist: run.assist, stopped: run.stopped,
      goal: run.assist === "predictive" ? [...kernel.goal] : null, ratio: this.ratio,
      cable: run.cable, utilisation: run.utilisation,
      event: run.event === null ? null : {text: run.event}, replaying: this.waiting.length > 0,
      task: task && {name: task.name, time: task.time, largest_swing: task.largest, energy: task.energy,
        done: task.done},
    });
  }

  /** Write a file of what was driven: columns as .csv, or crane and inputs as .json.
   * @param {string} file */
  save(file) {
    const {data: {crane}, run: {inputs, k}} = this;
    if (file.endsWith(".json")) {
      const blob = new Blob([JSON.stringify({crane: crane.record, instants: k, inputs})]);
      postMessage({type: "saved", file, blob});
      return;
    }
    let text = `${Object.values(crane.columns).flat().join(",")}\n`;
    // The rows of an hour are too long for one text.
    const pieces = /** @type {Blob[]} */ ([]);
    replay(this.data, this.code, inputs, k, run => {
      text += `${run.values().join(",")}\n`;
      if (run.k % 5000 && run.k < k) return;
      pieces.push(new Blob([text]));
      text = "";
    });
    postMessage({type: "saved", file, blob: new Blob([...pieces, text])});
  }

  /** Do what a message of the page asks for. @param {any} message */
  receive(message) {
    const {type} = message, {run} = this;
    if (type === "speed") this.factor = message.factor;
    else if (type === "save") this.save(message.file);
    else if (type === "reset") this.reset();
    else if (type === "replay") {
      const reason = replayRefusal(this.data, message.inputs);
      if (reason !== null) {
        postMessage({type: "refused", text: `${reason} Nothing of it is replayed.`});
        return;
      }
      this.run = new Run(this.data, this.code);
      this.due = 0;
      this.waiting = [...message.inputs].reverse();
    } else if (this.waiting.length) return; // inputs are ignored while a run is replayed
    else if (type === "sticks") {
      if (message.values.some((/** @type {number} */ x, /** @type {number} */ i) => x !== run.sticks[i])) {
        run.input("sticks", message.values);
      }
    } else if (type === "assist") run.input("assist", message.name);
    else if (type === "goal") run.input("goal", message.position);
    else if (type === "stop") run.input("stop", message.on);
    else if (type === "slider") run.input("slider", [message.name, message.value]);
    else if (type === "task") {
      run.task = null;
      this.reset();
      if (message.name) this.run.input("task", message.name);
    }
  }
}

/** @type {Promise<Session>} */
let session;

/** @param {MessageEvent} event */
onmessage = async ({data: message}) => {
  const {type, data} = message;
  if (type === "start") session = compile(data.kernel).then(code => new Session(data, code));
  else (await session).receive(message);
};

// The page hears of errors only, not of promises that failed.
onunhandledrejection = ({reason}) => { throw reason; };
