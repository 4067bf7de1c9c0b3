"use strict";

/**
 * @typedef {Object} KernelData
 * @property {Record<string, string>} modules WebAssembly by name, compressed.
 * @property {string} [horizon] Memory of the predictive controller before a run, compressed.
 * @property {number} [counts] Where that memory counts control instants [doubles].
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

/**
 * Compile the modules of a page.
 * @param {KernelData} data
 * @returns {Promise<{modules: Record<string, WebAssembly.Module>, horizon: Uint8Array}>}
 */
async function compile(data) {
  /** @type {Record<string, WebAssembly.Module>} */
  const modules = {};
  for (const [name, text] of Object.entries(data.modules)) {
    modules[name] = await WebAssembly.compile(await unpack(text));
  }
  return {modules, horizon: data.horizon ? await unpack(data.horizon) : new Uint8Array()};
}

/** The compiled crane with its memory: advances by one control period for one command. */
class Kernel {
  /** @param {KernelData} data @param {Awaited<ReturnType<typeof compile>>} code */
  constructor(data, code) {
    const {sizes, slots} = data;
    const doubles = Object.values(sizes).reduce((a, b) => a + b, 0) + Object.keys(slots).length;
    const bytes = STACK_BYTES + 8 * (doubles + data.numbers.length) + code.horizon.length;
    const memory = new WebAssembly.Memory({initial: Math.ceil(bytes / 65536)});
    let end = STACK_BYTES;
    /** @param {number} n */
    const take = n => {
      end += 8 * n;
      return new Float64Array(memory.buffer, end - 8 * n, n);
    };
    /** @type {Record<string, Float64Array>} */
    const buffers = {};
    for (const [name, n] of Object.entries(sizes)) buffers[name] = take(n);
    buffers.numbers = take(data.numbers.length);
    buffers.horizon = take(code.horizon.length / 8);
    const call = take(Object.keys(slots).length);
    const whole = new BigInt64Array(memory.buffer, call.byteOffset, call.length);
    for (const [name, buffer] of Object.entries(buffers)) {
      if (name in slots) whole[slots[name]] = BigInt(buffer.byteOffset);
    }
    const counts = {gain_table_rows: 1, setpoint_table_rows: 1, force_rows: 1, last: 1, end: 1,
      steps: data.steps, substeps: 1, log_interval: 1};
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
    this._queued = view("state", "unheard");
    this._reference = view("state", "reference");
    this.drives = data.drives;
    this.setState(data.state);
    this._horizon = new Uint8Array(memory.buffer, buffers.horizon.byteOffset, code.horizon.length);
    this._initial = code.horizon;
    this._counts = data.counts;
    this._invalid = view("summary", "invalid");
    this._address = call.byteOffset;
    /** @type {Record<string, (address: number) => void>} */
    this._run = {};
    const stack = new WebAssembly.Global({value: "i32", mutable: true}, STACK_BYTES);
    const env = {__linear_memory: memory, __stack_pointer: stack, fmin: Math.min, fmax: Math.max};
    for (const [name, module] of Object.entries(code.modules)) {
      const {run} = new WebAssembly.Instance(module, {env}).exports;
      this._run[name] = /** @type {(address: number) => void} */ (run);
    }
  }

  /** Begin at a state, its drives at their rates. @param {number[]} state q and v. */
  setState(state) {
    const rates = this.drives.map(joint => state[this.q.length + joint]);
    this._state.fill(0);
    this._state.set(state);
    this._reference.set(rates);
    this._queued.forEach((_, i) => { this._queued[i] = rates[i % rates.length]; });
  }

  /** Forget what the predictive controller remembers; it goes on from a control instant. @param {number} k */
  beginPlanning(k) {
    this._horizon.set(this._initial);
    const place = this._horizon.byteOffset + 8 * (this._counts ?? 0);
    new BigInt64Array(this._horizon.buffer, place, 2).fill(BigInt(k));
  }

  /**
   * Log the control instant, and advance by a control period.
   * @param {boolean} planned Whether the predictive controller commands the drives.
   * @returns {boolean} Whether the model held at the instant.
   */
  advance(planned) {
    this._invalid[0] = Infinity;
    this._run[planned ? "predictive" : "plain"](this._address);
    return this._invalid[0] === Infinity;
  }
}
