"use strict";

/**
 * @typedef {Object} AssistData What assistances need of the crane; joints and drives by index.
 * @property {number[]} rates Rates at full stick [rad/s or m/s].
 * @property {number[]} accelerations Of the ramps of the drives [rad/s² or m/s²].
 * @property {number[]} reaction Time from a command to the drive's deceleration [s].
 * @property {number[]} joints Joint of each drive.
 * @property {number} hoist Drive of the hoist, -1 for none.
 * @property {{lengths: number[], periods: number[]}} swing Swing period [s] over cable length [m].
 * @property {{x: number, phi: number, theta: number, l: number, slew: number, trolley: number,
 *   ratio: number, gravity: number}} [yielding] Joints of radius, swings and cable, drives of slew
 *   and trolley, damping ratio that they give the swing, and gravity [m/s²].
 * @property {{x: number, l: number, radii: number[], lengths: number[], gains: number[][],
 *   rest: number[], swings: number[], rest_slope: number[][]}} [lqr] Gains by radius and cable length,
 *   radius first; -1 for no such joint. Coordinates at rest at the start, and by how much those of the
 *   swings change with the position of each drive.
 * @property {{feedForward: number[], gain: number[][], setpoint: number[], shift: number[][],
 *   start: number[], a: number[][], b: number[][], c: number[][], antiWindup: number[][],
 *   limits: number[], initial: number[]}} [own] Linear controller of a user, see `LinearLaw` in
 *   crane_data.py; `start` has the positions of the drives at which the setpoint is `setpoint`.
 */

/** Where a number lies in a table: the index of the row before it, and the share of the way to the
 * next row.
 * @param {number[]} rows Numbers that increase. @param {number} x @returns {[number, number]} */
function locate(rows, x) {
  let i = 0;
  while (i < rows.length - 2 && x >= rows[i + 1]) i += 1;
  const step = rows.length > 1 ? rows[i + 1] - rows[i] : Infinity;
  return [i, Math.min(Math.max((x - rows[i]) / step, 0), 1)];
}

/** A number limited to [-limit, limit]. @param {number} x @param {number} limit */
const clip = (x, limit) => Math.min(Math.max(x, -limit), limit);

/** The product of a matrix, row by row, with a vector.
 * @param {number[][]} rows @param {number[]} x @returns {number[]} */
const product = (rows, x) => rows.map(row => row.reduce((sum, number, i) => sum + number * x[i], 0));

/** From the sticks of the operator to the commanded rates of the drives, with an assistance. */
class Assistant {
  /**
   * @param {AssistData} data @param {JointData[]} joints @param {number} period
   */
  constructor(data, joints, period) {
    this.data = data;
    this.joints = joints;
    this.period = period;
    /** @type {number[][]} Ramped rates of the last control instants, the latest first. */
    this.past = [];
    /** @type {number[]} Rates that the ramps of the drives allow now. */
    this.rate = [];
    /** @type {number[]} Positions to which these rates have led, about which feedback acts. */
    this.position = [];
    /** @type {number[]} States of a user's own controller. */
    this.states = [];
    /** Acceleration of the drives over its usual value. */
    this.ramps = 1;
    // The shaper looks back by half of a swing period.
    this.pastLength = Math.ceil(0.5 * Math.max(...data.swing.periods) / period) + 1;
  }

  /** Begin to assist from a state. @param {ArrayLike<number>} q @param {ArrayLike<number>} v */
  begin(q, v) {
    this.past = [];
    this.rate = this.data.joints.map(joint => v[joint]);
    this.position = this.data.joints.map(joint => q[joint]);
    this.states = [...this.data.own?.initial ?? []];
  }

  /**
   * Rates limited so that every drive can stop before the end of its range.
   * @param {number[]} rates @param {ArrayLike<number>} q @returns {number[]}
   */
  limited(rates, q) {
    return rates.map((rate, i) => {
      const joint = this.data.joints[i];
      const {lower, upper} = this.joints[joint];
      const slowest = -this.stoppable(i, q[joint] - lower);
      const fastest = this.stoppable(i, upper - q[joint]);
      return Math.min(Math.max(rate, slowest), fastest);
    });
  }

  /**
   * Largest rate from which a drive stops within a distance.
   *
   * From the rate w it goes on for the reaction time t, and then stops with the acceleration a:
   * w t + w²/(2 a) <= distance, of which the largest w is a (√(t² + 2 distance/a) - t).
   * @param {number} i Drive. @param {number} distance
   */
  stoppable(i, distance) {
    const acceleration = this.ramps * this.data.accelerations[i];
    const delay = this.data.reaction[i];
    const ahead = 2 * Math.max(distance, 0) / acceleration;
    return acceleration * (Math.sqrt(delay * delay + ahead) - delay);
  }

  /**
   * Commanded rates of the drives.
   * @param {string} name Of the assistance.
   * @param {number[]} sticks -1 to 1.
   * @param {ArrayLike<number>} q @param {ArrayLike<number>} v
   * @param {number | null} cable Length to which the hoist goes [m]; null for where its stick says.
   * @returns {number[]}
   */
  command(name, sticks, q, v, cable) {
    const {rates, hoist, joints} = this.data;
    const wanted = sticks.map((stick, i) => stick * rates[i]);
    if (cable !== null) {
      const way = cable - q[joints[hoist]];
      wanted[hoist] = Math.sign(way) * Math.min(rates[hoist], this.stoppable(hoist, Math.abs(way)));
    }
    const asked = this.limited(wanted, q);
    if (name === "shaped") return this.limited(this.shaped(asked, q), q);
    if (name === "yielding") return this.limited(this.yielding(asked, q), q);
    if (name === "lqr") return this.limited(this.lqr(asked, q, v), q);
    if (name === "own") return this.limited(this.own(asked, q, v), q);
    return asked;
  }

  /**
   * ZV shaping: half of the rates at once, and half of those of half a swing period ago, so that the
   * swings of both cancel. It shapes the rates after the ramps of the drives, which would spoil the
   * sum otherwise. The hoist, which starts no swing, gets what is asked.
   * @param {number[]} asked @param {ArrayLike<number>} q
   */
  shaped(asked, q) {
    this.ramp(asked);
    this.past.unshift(this.rate);
    if (this.past.length > this.pastLength) this.past.pop();
    const {lengths, periods} = this.data.swing;
    const {hoist} = this.data;
    const length = hoist < 0 ? lengths[0] : q[this.data.joints[hoist]];
    const [i, share] = locate(lengths, length);
    const next = periods[i + 1] ?? periods[i];
    const period = periods[i] + share * (next - periods[i]);
    const before = this.past[Math.round(0.5 * period / this.period)] ?? asked.map(() => 0);
    return this.rate.map((rate, j) => (j === hoist ? asked[j] : 0.5 * (rate + before[j])));
  }

  /** Let the rates follow within the accelerations of the drives. @param {number[]} asked */
  ramp(asked) {
    const {accelerations} = this.data;
    const {period, ramps} = this;
    this.rate = this.rate.map((r, i) => r + clip(asked[i] - r, ramps * accelerations[i] * period));
  }

  /**
   * Slew and trolley give way to the load, which damps its swing.
   *
   * The swing φ under a pivot that moves at the rate x' is l φ'' + g φ = x''. With x' = -k φ, which
   * is towards the load, it is l φ'' + k φ' + g φ = 0, whose damping ratio is ζ for k = 2 ζ √(g l).
   * The slew moves the pivot at the radius of the trolley, and not at all where that is 0.
   * @param {number[]} asked @param {ArrayLike<number>} q
   */
  yielding(asked, q) {
    const given = this.data.yielding;
    if (!given) return asked;
    const gain = 2 * given.ratio * Math.sqrt(given.gravity * q[given.l]);
    const rates = [...asked];
    rates[given.trolley] -= gain * q[given.phi];
    rates[given.slew] -= q[given.x] === 0 ? 0 : gain * q[given.theta] / q[given.x];
    return rates;
  }

  /**
   * Feedback of the whole state about a motion that follows the sticks, by gains that are
   * interpolated over radius and cable length.
   * @param {number[]} asked @param {ArrayLike<number>} q @param {ArrayLike<number>} v
   */
  lqr(asked, q, v) {
    const given = this.data.lqr;
    const {joints} = this.data;
    const {period} = this;
    if (!given) return asked;
    this.ramp(asked);
    // The goal is the load at rest below drives that move as the sticks ask for.
    const goal = [...given.rest, ...given.rest.map(() => 0)];
    joints.forEach((joint, i) => {
      this.position[i] += this.rate[i] * period;
      goal[joint] = this.position[i];
      goal[given.rest.length + joint] = this.rate[i];
    });
    given.swings.forEach((swing, k) => joints.forEach((joint, i) => {
      goal[swing] += given.rest_slope[k][i] * (this.position[i] - given.rest[joint]);
      goal[given.rest.length + swing] += given.rest_slope[k][i] * this.rate[i];
    }));
    const error = [...Array.from(q), ...Array.from(v)].map((z, i) => z - goal[i]);
    // Bilinear: the weights of the four corners of the cell in which radius and length lie.
    const [i, along] = locate(given.radii, given.x < 0 ? 0 : q[given.x]);
    const [j, down] = locate(given.lengths, given.l < 0 ? 0 : q[given.l]);
    const corners = [[i, j, (1 - along) * (1 - down)], [i, j + 1, (1 - along) * down],
      [i + 1, j, along * (1 - down)], [i + 1, j + 1, along * down]];
    const rates = [...this.rate];
    for (const [a, b, weight] of corners) {
      if (weight === 0) continue;
      const gains = given.gains[a * given.lengths.length + b];
      rates.forEach((_, k) => {
        let sum = 0;
        for (let n = 0; n < error.length; n += 1) sum += gains[k * error.length + n] * error[n];
        rates[k] -= weight * sum;
      });
    }
    return rates;
  }

  /**
   * A user's own linear controller, about drives that stand where the sticks have led.
   * @param {number[]} asked @param {ArrayLike<number>} q @param {ArrayLike<number>} v
   */
  own(asked, q, v) {
    const given = this.data.own;
    if (!given) return asked;
    this.ramp(asked);
    this.position = this.position.map((x, i) => x + this.rate[i] * this.period);
    const moved = product(given.shift, this.position.map((x, i) => x - given.start[i]));
    const deviation = [...Array.from(q), ...Array.from(v)]
      .map((z, i) => z - given.setpoint[i] - moved[i]);
    const byGain = product(given.gain, deviation);
    const byStates = product(given.c, this.states);
    const rates = given.feedForward.map((rate, i) => rate - byGain[i] + byStates[i]);
    // What the limits take away changes the states, so that they do not wind up.
    const removed = rates.map((rate, i) => clip(rate, given.limits[i]) - rate);
    const [next, byInput, back] = [product(given.a, this.states), product(given.b, deviation),
      product(given.antiWindup, removed)];
    this.states = next.map((x, i) => x + byInput[i] + back[i]);
    return rates;
  }
}
