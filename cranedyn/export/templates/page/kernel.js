"use strict";

/**
 * @typedef {Object} KernelData
 * @property {string} module WebAssembly, compressed.
 * @property {{module: string, memory: string, ratio: number, accelerations: number[]} | null} horizon
 *   Predictive controller: its code and its memory before a run, compressed, control periods between
 *   optimisations, and where in the memory the bounds of the accelerations stand [doubles].
 * @property {Record<string, number>} slots Slot of each argument of a call.
 * @property {Record<string, Record<string, number[]>>} sections First and last number of each
 *   section of each buffer.
 * @property {Record<string, number>} sizes Doubles in each buffer.
 * @property {number[]} numbers Varied numbers of the crane.
 * @property {Record<string, number[]>} variations What they gain by a unit of each slider.
 * @property {number[]} state Coordinates and rates at the start.
 * @property {number[]} drives Joint of each drive.
 * @property {number} dt
 * @property {number} period
 * @property {number} steps
 */

/** Bytes for the data and the stack of the code, which lie below all buffers. */
const STACK_BYTES = 1 << 20;

/** Bytes of a text that Python compressed. @param {string} text */
async function unpack(text) {
  const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Compile the code of a page. @param {KernelData} data */
async function compile({module, horizon}) {
  const texts = horizon ? [module, horizon.module] : [module];
  return {
    modules: await Promise.all(texts.map(async text => WebAssembly.compile(await unpack(text)))),
    memory: horizon ? new Float64Array((await unpack(horizon.memory)).buffer) : new Float64Array(),
  };
}

/** The compiled crane with its memory: advances by one control period for one command. */
class Kernel {
  /** @param {KernelData} data @param {Awaited<ReturnType<typeof compile>>} code */
  constructor(data, code) {
    const {sizes, slots, drives} = data;
    /** @type {Record<string, number>} */
    const doubles = {...sizes, numbers: data.numbers.length, plan: code.memory.length,
      query: data.state.length + drives.length + 2, answer: drives.length, call: Object.keys(slots).length};
    const all = Object.values(doubles).reduce((a, b) => a + b, 0);
    const memory = new WebAssembly.Memory({initial: Math.ceil((STACK_BYTES + 8 * all) / 65536)});
    let end = STACK_BYTES;
    /** @type {Record<string, Float64Array>} */
    const buffers = {};
    for (const [name, n] of Object.entries(doubles)) {
      buffers[name] = new Float64Array(memory.buffer, end, n);
      end += 8 * n;
    }
    const {call, query} = buffers;
    const whole = new BigInt64Array(memory.buffer, call.byteOffset, call.length);
    for (const [name, buffer] of Object.entries(buffers)) {
      if (name in slots) whole[slots[name]] = BigInt(buffer.byteOffset);
    }
    const counts = {gain_table_rows: 1, setpoint_table_rows: 1, force_rows: 1, last: 1, end: 1,
      steps: data.steps, substeps: 1, log_interval: 1, force_interval: 1};
    for (const [name, n] of Object.entries(counts)) whole[slots[name]] = BigInt(n);
    call[slots.dt] = data.dt;
    call[slots.period] = data.period;
    /** @param {string} buffer @param {string} section */
    const view = (buffer, section) => buffers[buffer].subarray(...data.sections[buffer][section]);
    this.q = view("state", "q");
    this.v = view("state", "v");
    /** Commanded rates of the drives until the next control instant. */
    this.command = view("gain_table", "feed_forward");
    /** Position of the drives to which the predictive controller goes. */
    this.goal = view("setpoint_table", "position");
    /** Forces on the points of the crane in the world [N]. */
    this.force = buffers.force;
    /** @type {Record<string, Float64Array>} What was logged at the last control instant. */
    this.row = {};
    for (const name of Object.keys(data.sections.log)) this.row[name] = view("log", name);
    this.numbers = buffers.numbers;
    this.numbers.set(data.numbers);
    this._state = buffers.state;
    this._queued = view("state", "delayed_commands");
    /** Rates of the drives after the ramps of their converters. */
    this.reference = view("state", "reference");
    this.drives = data.drives;
    this.setState(data.state);
    this._invalid = view("summary", "invalid");
    this._horizon = data.horizon;
    this._initial = code.memory;
    this._plan = buffers.plan;
    this._query = query;
    this._due = new BigInt64Array(memory.buffer, query.byteOffset + query.byteLength - 8, 1);
    this._answer = buffers.answer;
    this._fresh = true;
    const stack = new WebAssembly.Global({value: "i32", mutable: true}, STACK_BYTES);
    const env = {__linear_memory: memory, __stack_pointer: stack, fmin: Math.min, fmax: Math.max};
    const exported = Object.assign({}, ...code.modules.map(module => new WebAssembly.Instance(module, {env}).exports));
    /** @type {() => void} */
    this._run = () => exported.run(call.byteOffset);
    /** @type {() => void} */
    this._instant = () => exported.instant(buffers.plan.byteOffset, query.byteOffset, buffers.answer.byteOffset);
  }

  /** Begin at a state, its drives at their rates. @param {number[]} state q and v. */
  setState(state) {
    const rates = this.drives.map(joint => state[this.q.length + joint]);
    this._state.fill(0);
    this._state.set(state);
    this.reference.set(rates);
    this._queued.forEach((_, i) => { this._queued[i] = rates[i % rates.length]; });
  }

  /** Begin to plan afresh, with drives that accelerate a multiple of what is usual.
   * @param {number} ramps */
  beginPlanning(ramps) {
    this._plan.set(this._initial);
    this._fresh = true;
    this.setRamps(ramps);
  }

  /** Plan with other accelerations from the next optimisation on. @param {number} ramps */
  setRamps(ramps) {
    for (const first of this._horizon?.accelerations ?? []) {
      this.drives.forEach((_, i) => { this._plan[first + i] = ramps * this._initial[first + i]; });
    }
  }

  /** Rates of the drives by which the predictive controller goes to the goal.
   * @param {number} k Control instant. */
  plan(k) {
    const {q, v, _query, _due, _horizon} = this, n = q.length;
    _query.set(q);
    _query.set(v, n);
    _query.set(this.goal, 2 * n);
    _due[0] = BigInt(this._fresh || k % (_horizon?.ratio ?? 1) === 0);
    this._fresh = false;
    this._instant();
    return Array.from(this._answer);
  }

  /** Log the control instant, and advance by a control period; return whether the model held at
   * the instant. */
  advance() {
    this._invalid[0] = Infinity;
    this._run();
    return this._invalid[0] === Infinity;
  }
}
