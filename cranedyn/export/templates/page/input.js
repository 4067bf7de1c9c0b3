"use strict";
// Hands: keys, a gamepad and two sticks on the screen, all as deflections of the sticks in a cabin.

/** Axis and way of each key: 0 left stick across, 1 left stick along, 2 right stick along, 3 right stick
 * across.
 * @type {Record<string, [number, number]>} */
const DRIVE_KEYS = {
  ArrowLeft: [0, -1], KeyA: [0, -1], ArrowRight: [0, 1], KeyD: [0, 1],
  ArrowUp: [1, 1], KeyW: [1, 1], ArrowDown: [1, -1], KeyS: [1, -1],
  KeyR: [2, 1], PageUp: [2, 1], KeyF: [2, -1], PageDown: [2, -1], KeyQ: [3, -1], KeyE: [3, 1],
};

/** Roles of the drives of the first three axes. */
const AXIS_ROLES = ["slew", "trolley", "hoist"];

/** Number of axes. */
const AXES = 4;

/** Deflection of a stick below which it counts as released. */
const DEAD_ZONE = 0.12;

/** Share of the deflection that counts while Shift is held. */
const PRECISE_SHARE = 0.25;

/** Deflection without its dead zone, in hundredths, so that noise makes no inputs. @param {number} value */
const beyond = value => Math.sign(value) * Math.round(100 * Math.max(0, Math.abs(value) - DEAD_ZONE) / (1 - DEAD_ZONE)) / 100;

/** Drive of each axis: that of its role, and of the axes that are left in the order of the drives; -1 for
 * none. @param {JointData[]} joints Of the drives. @param {number | undefined} hoist Drive of the rope. */
function axesOf(joints, hoist) {
  const order = Array.from({length: AXES}, (_, i) => joints.findIndex(joint => joint.role === AXIS_ROLES[i]));
  if (order[2] < 0 && hoist !== undefined && !order.includes(hoist)) order[2] = hoist;
  joints.forEach((_, drive) => {
    const free = order.indexOf(-1);
    if (!order.includes(drive) && free >= 0) order[free] = drive;
  });
  return order;
}

/** The operator's hands. */
class Hands {
  /** @param {JointData[]} joints Of the drives. @param {number | undefined} hoist Drive of the rope of a
   *   crane whose joints have no roles. @param {HTMLElement[]} sticks Round, left and right, with a
   *   knob each. @param {(code: string) => boolean} act Does what another key stands for. */
  constructor(joints, hoist, sticks, act) {
    /** Drive of each axis; -1 for none. */
    this.order = axesOf(joints, hoist);
    // Sense of each drive along its coordinate: a push to the left turns the jib counter-clockwise, a
    // push forward moves the trolley outward, and a push up shortens the rope.
    this.senses = this.order.map(drive => drive >= 0 && (joints[drive].kind === "revolute"
      ? joints[drive].axis[2] > 0 : joints[drive].axis[2] < -0.5) ? -1 : 1);
    /** Deflections of the axes, -1 to 1. */
    this.axes = this.order.map(() => 0);
    this._values = joints.map(() => 0);
    this._screen = [0, 0, 0, 0];
    this._keys = /** @type {Set<string>} */ (new Set());
    this._knobs = sticks.map(stick => /** @type {HTMLElement} */ (stick.firstElementChild));
    sticks.forEach((stick, i) => this._hold(stick, 2 * i));
    addEventListener("keydown", event => {
      const {code, repeat, ctrlKey, altKey, metaKey, target} = event;
      const typing = /** @type {HTMLElement} */ (target).matches?.("input, dialog *");
      if (ctrlKey || altKey || metaKey || typing && code !== "Space") return;
      if (code in DRIVE_KEYS || code.startsWith("Shift")) this._keys.add(code);
      else if (!repeat && !act(code)) return;
      event.preventDefault();
    });
    addEventListener("keyup", event => {
      this._keys.delete(event.code);
      if (event.code.startsWith("Meta")) this._keys.clear(); // macOS drops releases before this one
      if (event.code === "Space") event.preventDefault(); // Firefox would press a button
    });
    addEventListener("blur", () => this._keys.clear());
  }

  /** Let a pointer hold a stick on the screen, which springs back.
   * @param {HTMLElement} stick @param {number} first Of its two deflections. */
  _hold(stick, first) {
    stick.onpointerdown = event => {
      stick.setPointerCapture(event.pointerId);
      stick.onpointermove?.(event);
    };
    stick.onpointermove = ({pointerId, clientX, clientY}) => {
      if (!stick.hasPointerCapture(pointerId)) return;
      const box = stick.getBoundingClientRect(), reach = 0.36 * box.width;
      const x = (clientX - box.left - box.width / 2) / reach;
      const y = (box.top + box.height / 2 - clientY) / reach, over = Math.max(1, Math.hypot(x, y));
      this._screen[first] = beyond(x / over);
      this._screen[first + 1] = beyond(y / over);
    };
    stick.onlostpointercapture = () => { this._screen.fill(0, first, first + 2); };
  }

  /** Deflection of each drive along its coordinate, -1 to 1, shape (m,); the same array at every call. */
  sticks() {
    const {axes, _screen: screen, _keys: keys, _values: values} = this;
    [axes[0], axes[1], axes[2], axes[3]] = [screen[0], screen[1], screen[3], screen[2]];
    for (const code of keys) if (code in DRIVE_KEYS) axes[DRIVE_KEYS[code][0]] += DRIVE_KEYS[code][1];
    for (const pad of navigator.getGamepads?.() ?? []) {
      if (!pad?.connected) continue;
      axes[0] += beyond(pad.axes[0] ?? 0);
      axes[1] -= beyond(pad.axes[1] ?? 0);
      axes[2] -= beyond(pad.axes[3] ?? 0);
      axes[3] += beyond(pad.axes[2] ?? 0);
    }
    const share = keys.has("ShiftLeft") || keys.has("ShiftRight") ? PRECISE_SHARE : 1;
    values.fill(0);
    for (let i = 0; i < AXES; i++) {
      axes[i] = share * Math.min(1, Math.max(-1, axes[i]));
      if (this.order[i] >= 0 && axes[i]) values[this.order[i]] = this.senses[i] * axes[i];
    }
    this._knobs[0].style.translate = `${82 * axes[0]}% ${-82 * axes[1]}%`;
    this._knobs[1].style.translate = `${82 * (this.order[3] < 0 ? 0 : axes[3])}% ${-82 * axes[2]}%`;
    return values;
  }
}
