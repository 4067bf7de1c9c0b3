"use strict";

/**
 * @typedef {Object} JointData
 * @property {string} symbol
 * @property {string} name
 * @property {string} unit
 * @property {"revolute"|"prismatic"} kind
 * @property {number} parent Index of the joint before it, -1 for the world.
 * @property {number[]} axis In the frame of the joint.
 * @property {number[]} rotation Of the joint in the frame of its parent, by rows.
 * @property {number[]} translation [m]
 * @property {number} lower
 * @property {number} upper
 * @property {boolean} driven
 * @property {string} role
 */

/** Poses of all joints in the world. Arrays are reused, since poses are computed at every control
 * instant. */
class Kinematics {
  /** @param {JointData[]} joints */
  constructor(joints) {
    this.joints = joints;
    /** Rotation by rows, then translation [m], of each joint. */
    this.poses = joints.map(() => new Float64Array(12));
    this._world = Float64Array.of(1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0);
    this._turn = new Float64Array(9);
    this._placed = new Float64Array(9);
  }

  /** Move all joints. @param {ArrayLike<number>} q */
  move(q) {
    for (let i = 0; i < this.joints.length; i += 1) {
      const {parent, rotation, translation, kind, axis: [x, y, z]} = this.joints[i];
      const pose = this.poses[i], before = parent < 0 ? this._world : this.poses[parent];
      if (kind === "revolute") {
        multiply(before, rotation, this._placed);
        // Rotation by q about the axis (x, y, z), by Rodrigues' formula.
        const c = Math.cos(q[i]), s = Math.sin(q[i]), d = 1 - c, turn = this._turn;
        turn[0] = c + x * x * d; turn[1] = x * y * d - z * s; turn[2] = x * z * d + y * s;
        turn[3] = y * x * d + z * s; turn[4] = c + y * y * d; turn[5] = y * z * d - x * s;
        turn[6] = z * x * d - y * s; turn[7] = z * y * d + x * s; turn[8] = c + z * z * d;
        multiply(this._placed, turn, pose);
      } else multiply(before, rotation, pose);
      const slide = kind === "prismatic" ? q[i] : 0;
      for (let k = 0; k < 3; k += 1) {
        const [a, b, e] = [before[3 * k], before[3 * k + 1], before[3 * k + 2]];
        pose[9 + k] = before[9 + k] + a * translation[0] + b * translation[1] + e * translation[2]
          + slide * (pose[3 * k] * x + pose[3 * k + 1] * y + pose[3 * k + 2] * z);
      }
    }
  }

  /** A point [m] that a joint carries, -1 for the world, in the world.
   * @param {number} joint @param {ArrayLike<number>} p @returns {number[]} */
  point(joint, p) {
    const m = joint < 0 ? this._world : this.poses[joint];
    return [
      m[9] + m[0] * p[0] + m[1] * p[1] + m[2] * p[2],
      m[10] + m[3] * p[0] + m[4] * p[1] + m[5] * p[2],
      m[11] + m[6] * p[0] + m[7] * p[1] + m[8] * p[2],
    ];
  }

  /** Velocity in the world [m/s] of a point of the world [m] that a joint carries.
   * @param {number} joint @param {number[]} point @param {ArrayLike<number>} v */
  velocity(joint, point, v) {
    const velocity = [0, 0, 0];
    for (let i = joint; i >= 0; i = this.joints[i].parent) {
      const m = this.poses[i], [x, y, z] = this.joints[i].axis;
      const axis = [0, 3, 6].map(k => m[k] * x + m[k + 1] * y + m[k + 2] * z);
      const arm = point.map((p, k) => p - m[9 + k]);
      const per = this.joints[i].kind === "prismatic" ? axis : cross(axis, arm);
      per.forEach((p, k) => { velocity[k] += v[i] * p; });
    }
    return velocity;
  }
}

/** Where a swing joint hangs at rest [rad]: affine in the positions of the drives, since a boom that luffs
 * turns the frame in which the angle of its rope is measured.
 * @param {{drives: number[], swings: number[], rest: number[], rest_slope: number[][]}} crane
 * @param {number} k Index among the swings. @param {ArrayLike<number>} q Coordinates. */
function hangingAngle({drives, swings, rest, rest_slope}, k, q) {
  return drives.reduce((sum, joint, i) => sum + rest_slope[k][i] * q[joint], rest[swings[k]]);
}

/** Rotation a b by rows. @param {ArrayLike<number>} a @param {ArrayLike<number>} b
 * @param {Float64Array} out */
function multiply(a, b, out) {
  for (let i = 0; i < 9; i += 3) {
    for (let j = 0; j < 3; j += 1) {
      out[i + j] = a[i] * b[j] + a[i + 1] * b[3 + j] + a[i + 2] * b[6 + j];
    }
  }
}

/** @param {ArrayLike<number>} a @param {ArrayLike<number>} b @returns {number[]} */
function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}
