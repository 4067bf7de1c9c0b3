"use strict";

/**
 * @typedef {Object} AssistData What assistances need of the crane; joints and drives by index.
 * @property {number[]} rates Rates at full stick.
 * @property {number[]} accelerations
 * @property {number[]} reaction Time from a command to the drive's deceleration [s].
 * @property {number[]} joints Joint of each drive.
 * @property {number} hoist Drive of the hoist, -1 for none.
 * @property {{lengths: number[], periods: number[]}} swing Swing period [s] over cable length [m].
 * @property {{x: number, phi: number, theta: number, l: number, slew: number, trolley: number,
 *   ratio: number, gravity: number}} [yielding]
 * @property {{x: number, l: number, radii: number[], lengths: number[], gains: number[][],
 *   rest: number[]}} [lqr] Gains by radius and cable length, radius first; -1 for no such joint.
 */

/** Straight line between rows: index of the row before, and the share of the way to the next.
 * @param {number[]} rows @param {number} x @returns {[number, number]} */
function locate(rows, x) {
  let i = 0;
  while (i < rows.length - 2 && x >= rows[i + 1]) i += 1;
  const step = rows.length > 1 ? rows[i + 1] - rows[i] : Infinity;
  return [i, Math.min(Math.max((x - rows[i]) / step, 0), 1)];
}

/** @param {number} x @param {number} limit */
const clip = (x, limit) => Math.min(Math.max(x, -limit), limit);

/** From sticks to commanded rates of the drives, with what assists the operator. */
class Assistant {
  /**
   * @param {AssistData} data @param {JointData[]} joints @param {number} period
   */
  constructor(data, joints, period) {
    this.data = data;
    this.joints = joints;
    this.period = period;
    /** @type {number[][]} Rates asked for at the last control instants, the latest first. */
    this.past = [];
    /** @type {number[]} */
    this.rate = [];
    /** @type {number[]} */
    this.position = [];
    /** Acceleration of the drives over its usual value. */
    this.ramps = 1;
    this.most = Math.ceil(0.5 * Math.max(...data.swing.periods) / period) + 1;
  }

  /** Begin to assist from a state. @param {ArrayLike<number>} q @param {ArrayLike<number>} v */
  begin(q, v) {
    this.past = [];
    this.rate = this.data.joints.map(joint => v[joint]);
    this.position = this.data.joints.map(joint => q[joint]);
  }

  /**
   * Rates within which every drive can stop before the end of its range.
   * @param {number[]} rates @param {ArrayLike<number>} q @returns {number[]}
   */
  limited(rates, q) {
    return rates.map((rate, i) => {
      const {lower, upper} = this.joints[this.data.joints[i]], at = q[this.data.joints[i]];
      return Math.min(Math.max(rate, -this.stoppable(i, at - lower)), this.stoppable(i, upper - at));
    });
  }

  /** Rate from which a drive stops within a way. @param {number} i @param {number} way */
  stoppable(i, way) {
    const a = this.ramps * this.data.accelerations[i], delay = this.data.reaction[i];
    return a * (Math.sqrt(delay * delay + 2 * Math.max(way, 0) / a) - delay);
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
    const {rates, hoist, joints} = this.data, wanted = sticks.map((stick, i) => stick * rates[i]);
    if (cable !== null) {
      const way = cable - q[joints[hoist]];
      wanted[hoist] = Math.sign(way) * Math.min(rates[hoist], this.stoppable(hoist, Math.abs(way)));
    }
    const asked = this.limited(wanted, q);
    if (name === "shaped") return this.limited(this.shaped(asked, q), q);
    if (name === "yielding") return this.limited(this.yielding(asked, q), q);
    if (name === "lqr") return this.limited(this.lqr(asked, q, v), q);
    return asked;
  }

  /** Half at once and half after half a period of the swing (ZV), after the ramps of the drives,
   * which would spoil the sum; the hoist as asked.
   * @param {number[]} asked @param {ArrayLike<number>} q */
  shaped(asked, q) {
    this.ramp(asked);
    this.past.unshift(this.rate);
    if (this.past.length > this.most) this.past.pop();
    const {lengths, periods} = this.data.swing, hoist = this.data.hoist;
    const length = hoist < 0 ? lengths[0] : q[this.data.joints[hoist]];
    const [i, share] = locate(lengths, length);
    const period = periods[i] + share * ((periods[i + 1] ?? periods[i]) - periods[i]);
    const before = this.past[Math.round(0.5 * period / this.period)] ?? asked.map(() => 0);
    return this.rate.map((rate, j) => (j === hoist ? asked[j] : 0.5 * (rate + before[j])));
  }

  /** Let the rates follow within the accelerations of the drives. @param {number[]} asked */
  ramp(asked) {
    const {accelerations} = this.data, {period, ramps} = this;
    this.rate = this.rate.map((r, i) => r + clip(asked[i] - r, ramps * accelerations[i] * period));
  }

  /** Slew and trolley give way to the load, which damps its swing.
   * @param {number[]} asked @param {ArrayLike<number>} q */
  yielding(asked, q) {
    const given = this.data.yielding;
    if (!given) return asked;
    const gain = 2 * given.ratio * Math.sqrt(given.gravity * q[given.l]);
    const rates = [...asked];
    rates[given.trolley] -= gain * q[given.phi];
    rates[given.slew] -= q[given.x] === 0 ? 0 : gain * q[given.theta] / q[given.x];
    return rates;
  }

  /** Feedback of the whole state about a motion that follows the sticks.
   * @param {number[]} asked @param {ArrayLike<number>} q @param {ArrayLike<number>} v */
  lqr(asked, q, v) {
    const given = this.data.lqr, {joints} = this.data, {period} = this;
    if (!given) return asked;
    this.ramp(asked);
    const goal = [...given.rest, ...given.rest.map(() => 0)];
    joints.forEach((joint, i) => {
      this.position[i] += this.rate[i] * period;
      goal[joint] = this.position[i];
      goal[given.rest.length + joint] = this.rate[i];
    });
    const error = [...Array.from(q), ...Array.from(v)].map((z, i) => z - goal[i]);
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
}
