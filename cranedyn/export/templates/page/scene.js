"use strict";
// The picture: a crane of a few hundred shapes in one vertex buffer. Each vertex carries the index of
// its body, whose pose is a uniform: the whole crane is one draw call, and its shadow another.

const VIEWS = ["cabin", "follow", "side", "top", "orbit"];

/** Time that the path of the load shows [s]. */
const PATH_SECONDS = 12;

/** Number of points of that path. */
const PATH_POINTS = 150;

/** Longest way of a drive that a view shows [m or rad]. */
const MAX_WAY = 200;

/** Largest number of points of all lines. */
const MAX_LINE_POINTS = 800;

/** Least width of a line where fewer pixels are drawn than the screen has [pixels]: a thinner one has gaps. */
const LEAST_WIDTH = 1.2;

/** Numbers of a vertex: position, normal, colour and body. */
const VERTEX_FLOATS = 11;

/** Numbers of a point of a line: position, width and colour. */
const LINE_FLOATS = 8;

/** Tangent of half the field of view. */
const TANGENT = Math.tan(0.42);

/** Radius of the rope [m]. */
const ROPE_RADIUS = 0.05;

/** Distance of the eye over the least from which all is seen. */
const FIT_MARGIN = 1.06;

/** Direction in which the view from the side looks at a crane that turns: square to the jib, and a
 * little down. Along the jib, to its left, up. */
const SQUARE_TO_JIB = [0, 0.99, -0.12];

/** The same for a crane that does not turn, along its longer and its shorter side: obliquely, so that
 * its ways along both are seen. */
const OBLIQUE = [-0.45, 0.83, -0.33];

/** Length of the rope from which on cameras, rings and what stands for a size are not scaled down [m]. */
const USUAL_ROPE = 5;

/** Shares of the screen's resolution that are drawn: at most, at least, and at first where no graphics
 * processor draws. */
const QUALITY = {most: 1, least: 0.4, software: 0.64};

/** Time between two pictures that counts as slow [ms]. */
const SLOW_PICTURE = 45;

/** Number of slow pictures after which fewer pixels are drawn. */
const SLOW_PICTURES = 10;

/** Time in which the eye moves from one view to another [s]. */
const MOVE_SECONDS = 0.6;

/** Time constant with which the picture follows a change of its free part [s]. */
const FREE_SECONDS = 0.15;

/** Distance at which haze takes half of the light: at least [m], and over the distance of what is looked
 * at, so that a large crane is seen. */
const HAZE = {least: 200, ratio: 3};

/** Number of dashes from the load to its goal on the ground. */
const GOAL_DASHES = 24;

const UNIFORMS = ["ahead", "bodies", "camera", "clear", "cut", "eye", "ground", "lamp", "right", "shade", "size", "up"];

/** Red, green and blue of a hex colour, 0 to 1. @param {string} hex */
const channels = hex => [1, 3, 5].map(i => parseInt(hex.slice(i, i + 2), 16) / 255);

/** Triangles of a profile turned about Z, six numbers a corner: position and normal. The profile is
 * pairs of points (radius, height, normal outward, normal upward).
 * @param {number[][][]} profile @param {number} sides */
function revolve(profile, sides) {
  /** @param {number[]} p @param {number} k */
  const corner = ([r, z, outward, upward], k) => {
    const c = Math.cos(2 * Math.PI * k / sides), s = Math.sin(2 * Math.PI * k / sides);
    return [c * r, s * r, z, c * outward, s * outward, upward];
  };
  return profile.flatMap(([a, b]) => Array.from({length: sides}, (_, k) => {
    const [p, q, r, t] = [corner(a, k), corner(b, k), corner(b, k + 1), corner(a, k + 1)];
    return [p, q, r, p, r, t].flat();
  }).flat());
}

/** Triangles with flat normals. @param {number[]} vertices @param {number[]} triangles */
function faceted(vertices, triangles) {
  const out = [];
  for (let i = 0; i < triangles.length; i += 3) {
    const [a, b, c] = [0, 1, 2].map(k => vertices.slice(3 * triangles[i + k], 3 * triangles[i + k] + 3));
    const normal = cross(b.map((x, k) => x - a[k]), c.map((x, k) => x - a[k]));
    const length = Math.hypot(...normal) || 1, flat = normal.map(x => x / length);
    out.push(...a, ...flat, ...b, ...flat, ...c, ...flat);
  }
  return out;
}

/** Triangles of a cylinder about Z. @param {number} r @param {number} length */
function cylinder(r, length) {
  const h = length / 2;
  return revolve([[[0, h, 0, 1], [r, h, 0, 1]], [[r, h, 1, 0], [r, -h, 1, 0]],
    [[r, -h, 0, -1], [0, -h, 0, -1]]], 20);
}

const CUBE = Array.from({length: 8}, (_, i) => [i & 1, i >> 1 & 1, i >> 2]).flat().map(x => x - 0.5);
const CUBE_SIDES = [0, 2, 3, 0, 3, 1, 4, 5, 7, 4, 7, 6, 0, 1, 5, 0, 5, 4, 2, 6, 7, 2, 7, 3, 0, 4, 6,
  0, 6, 2, 1, 3, 7, 1, 7, 5];

/** Triangles of a shape in its own frame. @param {Shape} shape */
function surface({kind, size, vertices = [], triangles = []}) {
  if (kind === "box") return faceted(CUBE.map((x, i) => x * size[i % 3]), CUBE_SIDES);
  if (kind === "cylinder") return cylinder(size[0], size[1]);
  if (kind === "mesh") return faceted(vertices, triangles);
  const points = Array.from({length: 11}, (_, k) => {
    const x = Math.sin(k * Math.PI / 10), z = Math.cos(k * Math.PI / 10);
    return [size[0] * x, size[0] * z, x, z];
  });
  return revolve(points.slice(1).map((point, k) => [points[k], point]), 16);
}

/** Half of the edges of the box about a shape in its own frame [m]. @param {Shape} shape */
function halfEdges({kind, size}) {
  if (kind === "cylinder") return [size[0], size[0], size[1] / 2];
  if (kind === "sphere") return [size[0], size[0], size[0]];
  return size.map(edge => edge / 2);
}

/** The eight corners of a box. @param {number[]} low @param {number[]} high */
const boxCorners = (low, high) => Array.from({length: 8}, (_, i) => low.map((x, k) => i >> k & 1 ? high[k] : x));

/** @param {ArrayLike<number>} a @param {ArrayLike<number>} b */
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/** Whether no graphics processor draws here; smooth edges then cost half of the pictures. */
function drawsInSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2");
  const names = gl?.getExtension("WEBGL_debug_renderer_info");
  return names ? /swiftshader|llvmpipe|software/i.test(gl?.getParameter(names.UNMASKED_RENDERER_WEBGL)) : false;
}

/** The crane, its site and the camera on a canvas. */
class Scene {
  /** @param {HTMLCanvasElement} canvas @param {ViewData} data */
  constructor(canvas, data) {
    const inSoftware = drawsInSoftware();
    const gl = canvas.getContext("webgl2", {stencil: true, alpha: false, antialias: !inSoftware});
    if (!gl) throw new Error("This browser has no WebGL 2: there are numbers, but no picture.");
    const {crane} = data;
    this.canvas = canvas; this.gl = gl; this.crane = crane;
    this.kinematics = new Kinematics(crane.joints);
    /** Points of the rope in the world [m], from pivot to load. */
    this.rope = crane.points.map(() => [0, 0, 0]);
    /** Three rows of each pose: of the world, the joints, the pieces of the rope. */
    this.bodies = new Float32Array(12 * (crane.joints.length + crane.points.length));
    /** Programs by day and by night, compiled when they are first needed. @type {Programs[]} */
    this._compiled = [];
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.stencilFunc(gl.EQUAL, 0, 255);
    gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
    this._array = this._buffer(VERTEX_FLOATS, [3, 3, 4, 1], 0);
    this._lines = new Float32Array(LINE_FLOATS * MAX_LINE_POINTS);
    this._lineArray = this._buffer(LINE_FLOATS, [4, 4], 1);
    this._path = new Float32Array(3 * PATH_POINTS);
    this._pathLength = this._pathTime = this._lineCount = 0;
    this.eye = [0, 0, 0]; this.target = [0, 0, 0]; this.forward = [0, 0, 0];
    /** The part of the picture that nothing covers: its middle and half of its size, where the picture
     * reaches from -1 to 1 and y is up. */
    this.free = {x: 0, y: 0, halfWidth: 1, halfHeight: 1};
    /** What it is to become. */
    this.nextFree = {...this.free};
    /** Ray through the middle of the picture, one unit ahead. */
    this.ahead = [0, 0, 0];
    /** Sideways and upward to the edges of the picture, one unit ahead. */
    this.right = [0, 0, 0]; this.up = [0, 0, 0];
    this.camera = new Float32Array(16);
    this._from = [0, 0, 0, 0, 0, 0];
    this._orbit = {yaw: 0, pitch: 0, distance: 60};
    this._view = "";
    this._blend = this._zoom = 1;
    /** Share of the screen's resolution that is drawn, less where the machine is slow. */
    this.quality = inSoftware ? QUALITY.software : QUALITY.most;
    this._last = this._slow = 0;
    this._colours = [data.colours.x || "#D55E00", "#009E73", "#0072B2"].map(channels);
    /** Joint along whose axis the operator looks: the trolley, or the last that moves level. */
    this.boom = crane.drives.filter(i => crane.joints[i].kind === "prismatic"
      && Math.abs(crane.joints[i].axis[2]) < 0.5).pop() ?? -1;
    this.turning = crane.joints.some(joint => joint.role === "slew");
    /** Radius about the load that nothing hides in the view that follows it [m]. */
    this.clearing = 0.5 + Math.hypot(...crane.load[7].map((x, k) => x - crane.load[3][k])) / 2;
    /** Height of the crane, and distance from its middle to its farthest end [m]. */
    this.height = this.reach = 0;
    this.middle = [0, 0, 0];
    /** Direction of the jib on the ground, (dx, dy); (-dy, dx) points to the left of it. */
    this.jib = [0, -1];
    /** Corners of the box about the crane on all of its ways [m]: along the jib, to its left, up. */
    this.corners = [[0, 0, 0]];
    /** Scale of what a small crane needs smaller. */
    this.scale = 1;
    this._move(crane.start);
    this._measure();
    this.build(data.site?.solids ?? []);
  }

  /** Position of the load in the world [m]. */
  get load() { return this.rope[this.rope.length - 1]; }

  /** All programs, by day (0) or by night (1). @param {number} night */
  _programs(night) {
    this._compiled[night] ??= {body: this._program("body", night), back: this._program("back", night),
      line: this._program("line", night)};
    return this._compiled[night];
  }

  /** Compile the program of a name and look up its uniforms. @param {string} name
   * @param {number} night 0 by day, 1 by night. */
  _program(name, night) {
    const {gl} = this, program = gl.createProgram();
    /** @param {string} id */
    const text = id => document.getElementById(id)?.textContent ?? "";
    const head = "#version 300 es\nprecision highp float;\n"
      + `#define BODIES ${this.bodies.length / 12}\n#define NIGHT ${night}.0\n`;
    for (const [type, source] of [[gl.VERTEX_SHADER, text(`${name}_vertex`)],
      [gl.FRAGMENT_SHADER, text("light") + text(`${name}_fragment`)]]) {
      const shader = /** @type {WebGLShader} */ (gl.createShader(Number(type)));
      gl.shaderSource(shader, head + source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
      throw new Error(`The picture cannot be drawn: ${gl.getProgramInfoLog(program)}`);
    }
    const uniforms = Object.fromEntries(UNIFORMS.map(name => [name, gl.getUniformLocation(program, name)]));
    return {program, uniforms};
  }

  /** Make a buffer of vertices with attributes of some sizes, each vertex an instance or not.
   * @param {number} floats @param {number[]} sizes @param {number} divisor */
  _buffer(floats, sizes, divisor) {
    const {gl} = this, array = gl.createVertexArray(), buffer = gl.createBuffer();
    return {array, buffer, bind: (/** @type {number} */ first = 0) => {
      gl.bindVertexArray(array);
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      let at = first * floats;
      // Instances carry two neighbouring points, so that a buffer of points is one of lines.
      for (let i = 0; i < sizes.length * (1 + divisor); i++) {
        gl.enableVertexAttribArray(i);
        gl.vertexAttribDivisor(i, divisor);
        gl.vertexAttribPointer(i, sizes[i % sizes.length], gl.FLOAT, false, 4 * floats, 4 * at);
        at += sizes[i % sizes.length];
      }
    }};
  }

  /** Put all triangles into one buffer: structure, load with rope, solids, zones.
   * @param {Solid[]} solids */
  build(solids) {
    const {gl, crane: {shapes, joints, points}} = this, floats = /** @type {number[]} */ ([]);
    /** @param {number[]} r @param {number[]} p @param {number[]} t */
    const placed = (r, [x, y, z], t) => t.map((s, k) => r[3 * k] * x + r[3 * k + 1] * y + r[3 * k + 2] * z + s);
    /** @param {number[]} corners @param {number} body @param {number[]} colour @param {number[]} r
     * @param {number[]} t */
    const add = (corners, body, colour, r = [1, 0, 0, 0, 1, 0, 0, 0, 1], t = [0, 0, 0]) => {
      for (let i = 0; i < corners.length; i += 6) {
        const normal = placed(r, corners.slice(i + 3, i + 6), [0, 0, 0]);
        floats.push(...placed(r, corners.slice(i, i + 3), t), ...normal, ...colour, body);
      }
    };
    /** @param {boolean} payload */
    const addShapes = payload => shapes.filter(shape => shape.payload === payload).forEach(shape =>
      add(surface(shape), shape.joint + 1, shape.colour, shape.rotation, shape.translation));
    /** @param {boolean} zone @param {number[]} colour */
    const addSolids = (zone, colour) => solids.filter(solid => solid.zone === zone).forEach(solid =>
      add(faceted(solid.vertices, solid.triangles), 0, colour));
    const addRope = () => points.slice(1).forEach((_, k) =>
      add(cylinder(1, 1), 1 + joints.length + k, [0.1, 0.1, 0.1, 1]));
    /** Vertices up to the end of structure, load and rope, solids, zones. */
    this.counts = [() => addShapes(false), () => (addShapes(true), addRope()),
      () => addSolids(false, [0.73, 0.69, 0.62, 1]), () => addSolids(true, [0.8, 0.2, 0.07, 0.25]),
    ].map(part => (part(), floats.length / VERTEX_FLOATS));
    this._array.bind();
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(floats), gl.STATIC_DRAW);
    this._lineArray.bind();
    gl.bufferData(gl.ARRAY_BUFFER, this._lines, gl.DYNAMIC_DRAW);
  }

  /** Measure the crane on all of its ways, for the views of all of it. */
  _measure() {
    const {kinematics, crane: {shapes, ground, joints, drives, start}, boom, turning} = this;
    const places = /** @type {number[][]} */ ([]);
    const add = () => {
      for (const {joint, translation, rotation, ...shape} of shapes) {
        const half = halfEdges(/** @type {Shape} */ (shape));
        for (const corner of boxCorners(half.map(x => -x), half)) {
          places.push(kinematics.point(joint, translation.map((x, k) => x + dot(rotation.slice(3 * k), corner))));
        }
      }
      places.push([...this.load]);
    };
    this._turnJib();
    const [dx, dy] = this.jib;
    add();
    for (const i of drives) {
      // A crane that turns is followed, and a range may be endless.
      const {kind, role, axis, lower, upper} = joints[i];
      if (role === "slew" || kind === "revolute" && Math.abs(axis[2]) > 0.9) continue;
      for (const end of [lower, upper]) {
        if (Math.abs(end) > MAX_WAY) continue;
        this._move(Object.assign([...start], {[i]: end}));
        add();
      }
    }
    this._move(start);
    const pivot = this.rope[0], rope = Math.hypot(...pivot.map((x, k) => x - this.load[k]));
    this.scale = Math.min(1, rope / USUAL_ROPE);
    places.push([pivot[0], pivot[1], ground]);
    const inJib = places.map(([x, y, z]) => [x * dx + y * dy, y * dx - x * dy, Math.max(z, ground)]);
    const [low, high] = [Math.min, Math.max].map(end => [0, 1, 2].map(k => end(...inJib.map(place => place[k]))));
    this.corners = boxCorners(low, high);
    this.height = high[2] - ground;
    const [along, left] = [0, 1].map(k => turning ? 0 : (low[k] + high[k]) / 2);
    this.middle = [along * dx - left * dy, along * dy + left * dx, (low[2] + high[2]) / 2];
    this.reach = Math.max(turning && boom >= 0 ? joints[boom].upper : 0, high[0] - along, along - low[0],
      high[1] - left, left - low[1]);
  }

  /** Find the direction of the jib on the ground. */
  _turnJib() {
    if (this.boom < 0) return;
    const pose = this.kinematics.poses[this.boom], {axis} = this.crane.joints[this.boom];
    const [x, y] = [0, 3].map(k => dot(pose.slice(k, k + 3), axis)), length = Math.hypot(x, y);
    if (length > 1e-9) this.jib = [x / length, y / length];
  }

  /** Move all bodies. @param {ArrayLike<number>} q Coordinates [rad or m]. */
  _move(q) {
    const {kinematics: {poses}, bodies, rope, crane: {joints, points}} = this;
    this.kinematics.move(q);
    bodies[0] = bodies[5] = bodies[10] = 1;
    for (let i = 0; i < joints.length; i++) {
      for (let k = 0; k < 3; k++) {
        const o = 12 * (i + 1) + 4 * k;
        for (let j = 0; j < 3; j++) bodies[o + j] = poses[i][3 * k + j];
        bodies[o + 3] = poses[i][9 + k];
      }
    }
    points.forEach(({joint, point}, i) => { rope[i] = this.kinematics.point(joint, point); });
    for (let i = 1; i < rope.length; i++) {
      const [a, b] = [rope[i - 1], rope[i]], along = b.map((x, k) => x - a[k]);
      const first = cross([0, 1, 0], along), second = cross(along, first);
      const [r, s] = [first, second].map(p => ROPE_RADIUS / (Math.hypot(...p) || 1));
      for (let k = 0; k < 3; k++) {
        bodies.set([r * first[k], s * second[k], along[k], (a[k] + b[k]) / 2], 12 * (joints.length + i) + 4 * k);
      }
    }
  }

  /** Positions of the drives that bring the load as near to a point [m] as their ranges allow, and
   * where it then hangs [m]: each drive in turn takes the step that brings it nearest.
   * @param {ArrayLike<number>} start @param {number[]} goal */
  reachFor(start, goal) {
    const {crane, kinematics} = this, {drives, joints, swings, points} = crane, q = Array.from(start);
    const {joint, point} = points[points.length - 1];
    const place = () => {
      swings.forEach((i, k) => { q[i] = hangingAngle(crane, k, q); });
      kinematics.move(q);
      return kinematics.point(joint, point);
    };
    for (let round = 0; round < 12; round++) {
      for (const i of drives) {
        const here = place();
        q[i] += 1e-5;
        const step = place().map((x, k) => (x - here[k]) / 1e-5);
        const gain = step.reduce((sum, x, k) => sum + x * (goal[k] - here[k]), 0);
        q[i] += gain / Math.max(step.reduce((sum, x) => sum + x * x, 0), 1e-6) - 1e-5;
        q[i] = Math.min(joints[i].upper, Math.max(joints[i].lower, q[i]));
      }
    }
    return {position: drives.map(i => q[i]), place: place()};
  }

  /** Draw one picture. @param {ArrayLike<number>} q Coordinates [rad or m]. @param {Look} look */
  draw(q, look) {
    const {gl, bodies, counts = []} = this, programs = this._programs(Number(look.night));
    const passed = this._resize();
    this._move(q);
    this._moveFree(passed);
    this._aim(q, look.view, passed);
    const grounded = this._layLines(look);
    gl.clear(gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    gl.disable(gl.DEPTH_TEST);
    this._use(programs.back);
    gl.drawArrays(gl.TRIANGLES, 0, 3);

    const body = this._use(programs.body);
    gl.uniformMatrix3x4fv(body.bodies, false, bodies);
    this._array.bind();
    // Each pixel is darkened once; the shadow of the load, the darker one, comes first.
    gl.enable(gl.STENCIL_TEST);
    gl.uniform4f(body.shade, 0, 0, 0.02, look.night ? 0.85 : 0.62);
    gl.drawArrays(gl.TRIANGLES, counts[0], counts[1] - counts[0]);
    gl.uniform4f(body.shade, 0, 0, 0.02, look.night ? 0.35 : 0.2);
    gl.drawArrays(gl.TRIANGLES, 0, counts[0]);
    gl.disable(gl.STENCIL_TEST);
    this._drawLines(programs.line, 0, grounded);

    gl.enable(gl.DEPTH_TEST);
    this._use(programs.body);
    this._array.bind();
    gl.uniform4f(body.shade, 0, 0, 0, 0);
    gl.uniform4f(body.cut, 0, 0, 0, 0);
    const [x, y, z] = this.load, clearing = look.view === "follow" ? this.clearing : 0;
    gl.drawArrays(gl.TRIANGLES, counts[0], counts[1] - counts[0]);
    gl.uniform4f(body.cut, x, y, z, clearing);
    gl.drawArrays(gl.TRIANGLES, 0, counts[0]);
    gl.drawArrays(gl.TRIANGLES, counts[1], counts[2] - counts[1]);
    gl.depthMask(false);
    gl.drawArrays(gl.TRIANGLES, counts[2], counts[3] - counts[2]);
    this._drawLines(programs.line, grounded, this._lineCount);
    gl.depthMask(true);
  }

  /** Use a program, with what all of them know. @param {Program} program */
  _use({program, uniforms}) {
    const {gl, canvas} = this;
    gl.useProgram(program);
    gl.uniform1f(uniforms.ground, this.crane.ground);
    const distance = Math.hypot(...this.eye.map((x, k) => x - this.target[k]));
    gl.uniform1f(uniforms.clear, Math.max(HAZE.least, HAZE.ratio * distance));
    gl.uniform3fv(uniforms.lamp, this.rope[0]);
    for (const name of /** @type {const} */ (["eye", "ahead", "right", "up"])) gl.uniform3fv(uniforms[name], this[name]);
    gl.uniformMatrix4fv(uniforms.camera, false, this.camera);
    gl.uniform2f(uniforms.size, canvas.width, canvas.height);
    return uniforms;
  }

  /** Fit the drawing to the window, with fewer pixels where pictures took long; return the time since
   * the last picture [s]. */
  _resize() {
    const {canvas} = this, now = performance.now(), passed = Math.min(now - this._last, 500);
    this._last = now;
    this._slow = Math.max(0, this._slow + (passed > SLOW_PICTURE ? 1 : -1));
    if (this._slow > SLOW_PICTURES && this.quality > QUALITY.least) {
      this.quality = Math.max(QUALITY.least, 0.8 * this.quality);
      this._slow = 0;
    }
    const ratio = this.quality * (window.devicePixelRatio || 1);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map(x => Math.max(1, Math.round(x * ratio)));
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    this.gl.viewport(0, 0, width, height);
    return passed / 1000;
  }

  /** Let the free part of the picture follow what it is to become. @param {number} passed [s] */
  _moveFree(passed) {
    const {free, nextFree} = this, share = this._view ? 1 - Math.exp(-passed / FREE_SECONDS) : 1;
    for (const key of /** @type {const} */ (["x", "y", "halfWidth", "halfHeight"])) {
      free[key] += share * (nextFree[key] - free[key]);
    }
  }

  /** Set eye and target of a view, and move there from the view before.
   * @param {ArrayLike<number>} q @param {string} view @param {number} passed [s] */
  _aim(q, view, passed) {
    const {eye, target, load, crane, middle, height, reach, scale, turning} = this;
    const aspect = this.canvas.width / this.canvas.height, [pivot] = this.rope;
    if (view !== this._view) {
      // The orbit goes round from the view before; a page that begins with it has none yet.
      if (view === "orbit" && !this._view) this._aim(q, "side", 0);
      if (view === "orbit") {
        const away = eye.map((x, k) => x - target[k]), distance = Math.hypot(...away) || 1;
        this._orbit = {yaw: Math.atan2(away[1], away[0]), pitch: Math.asin(away[2] / distance), distance};
      }
      this._from = [...eye, ...target];
      this._blend = this._view && view !== "orbit" ? 0 : 1;
      this._zoom = 1;
      this._view = view;
    }
    this._turnJib();
    const [dx, dy] = this.jib, zoom = this._zoom;
    const box = this.corners.map(([u, w, z]) => [u * dx - w * dy, u * dy + w * dx, z]);
    if (view === "cabin") {
      const along = this.boom < 0 ? 0 : crane.joints[this.boom].lower - q[this.boom];
      const [right, up] = [-1.9 * scale, -0.7 * scale];
      for (let k = 0; k < 3; k++) target[k] = load[k] + (k < 2 ? 0.5 : 0.15) * (pivot[k] - load[k]);
      [eye[0], eye[1], eye[2]] = [pivot[0] + along * dx + right * dy, pivot[1] + along * dy - right * dx, pivot[2] + up];
    } else if (view === "follow") {
      const [along, right, up] = [13, -9, 6.5].map(x => x * zoom * scale);
      [target[0], target[1], target[2]] = [load[0], load[1], load[2] + scale];
      [eye[0], eye[1], eye[2]] = [load[0] + along * dx + right * dy, load[1] + along * dy - right * dx, load[2] + up];
    } else if (view === "top") {
      // Not straight above, so that -Y, along the jib at the start, is up.
      const low = [middle[0] - reach, middle[1] - reach, crane.ground];
      const circle = boxCorners(low, [middle[0] + reach, middle[1] + reach, crane.ground + height]);
      this._fit(turning ? circle : box, [0, -1e-3, -1], aspect);
    } else if (view === "side") {
      const low = this.corners[0], high = this.corners[7], across = high[1] - low[1] > high[0] - low[0];
      const [a, b, up] = turning ? SQUARE_TO_JIB : OBLIQUE, [along, left] = across ? [b, a] : [a, b];
      this._fit(box, [along * dx - left * dy, along * dy + left * dx, up], aspect);
    } else {
      const {yaw, pitch, distance} = this._orbit, flat = distance * Math.cos(pitch);
      [eye[0], eye[1]] = [target[0] + flat * Math.cos(yaw), target[1] + flat * Math.sin(yaw)];
      eye[2] = target[2] + distance * Math.sin(pitch);
    }
    eye[2] = Math.max(eye[2], crane.ground + 0.5);
    if (this._blend < 1) {
      this._blend = Math.min(1, this._blend + passed / MOVE_SECONDS);
      const {_from} = this, s = this._blend * this._blend * (3 - 2 * this._blend);
      [eye, target].forEach((place, i) => place.forEach((x, k) => {
        place[k] = _from[3 * i + k] + s * (x - _from[3 * i + k]);
      }));
    }
    this._look(aspect);
  }

  /** Set the axes of the camera for a direction in which it looks. @param {number[]} direction */
  _face(direction) {
    const {right, up, forward} = this, length = Math.hypot(...direction) || 1;
    direction.forEach((x, k) => { forward[k] = x / length; });
    const flat = Math.hypot(forward[0], forward[1]) || 1;
    [right[0], right[1], right[2]] = [forward[1] / flat, -forward[0] / flat, 0];
    [up[0], up[1], up[2]] = cross(right, forward);
  }

  /** Set eye and target so that points [m] just fit into the free part of the picture.
   * @param {number[][]} points @param {number[]} direction In which the eye looks.
   * @param {number} aspect */
  _fit(points, direction, aspect) {
    const {eye, target, right, up, forward, free} = this;
    this._face(direction);
    /** Middle of the points along an axis. @param {number[]} axis */
    const middle = axis => {
      const places = points.map(point => dot(point, axis));
      return (Math.min(...places) + Math.max(...places)) / 2;
    };
    const [x, y, z] = [right, up, forward].map(middle);
    // A point at the depth d + (z' - z) is seen if its distance from the axis is at most the tangent of
    // the half angle times that depth.
    const distances = points.map(point => Math.max(
      Math.abs(dot(point, right) - x) / (TANGENT * aspect * free.halfWidth),
      Math.abs(dot(point, up) - y) / (TANGENT * free.halfHeight)) - (dot(point, forward) - z));
    const distance = FIT_MARGIN * this._zoom * Math.max(...distances);
    for (let k = 0; k < 3; k++) {
      target[k] = x * right[k] + y * up[k] + z * forward[k];
      eye[k] = target[k] - distance * forward[k];
    }
  }

  /** Compute axes and matrix of the camera from eye and target. @param {number} aspect */
  _look(aspect) {
    const {eye, target, right, up, forward, ahead, camera, free} = this, near = 0.3 * this.scale, far = 900;
    this._face(target.map((x, k) => x - eye[k]));
    const deep = (far + near) / (far - near);
    for (let i = 0; i < 4; i++) {
      /** @param {number[]} axis */
      const along = axis => i < 3 ? axis[i] : -dot(axis, eye);
      // What is straight ahead is in the middle of the free part.
      camera[4 * i] = along(right) / (TANGENT * aspect) + free.x * along(forward);
      camera[4 * i + 1] = along(up) / TANGENT + free.y * along(forward);
      camera[4 * i + 2] = deep * along(forward) - (i < 3 ? 0 : 2 * far * near / (far - near));
      camera[4 * i + 3] = along(forward);
    }
    right.forEach((x, k) => { right[k] = TANGENT * aspect * x; });
    up.forEach((x, k) => { up[k] = TANGENT * x; });
    forward.forEach((x, k) => { ahead[k] = x - free.x * right[k] - free.y * up[k]; });
  }

  /** Turn the orbit by a drag [pixels]. @param {number} x @param {number} y */
  turn(x, y) {
    this._orbit.yaw -= 0.006 * x;
    this._orbit.pitch = Math.min(1.55, Math.max(-0.1, this._orbit.pitch + 0.006 * y));
  }

  /** Move the eye nearer (below 1) or farther. @param {number} factor */
  zoom(factor) {
    this._zoom = Math.min(4, Math.max(0.2, this._zoom * factor));
    this._orbit.distance = Math.min(300, Math.max(3, this._orbit.distance * factor));
  }

  /** Point of the ground [m] under a point of the window [pixels], null above the horizon.
   * @param {number} x @param {number} y */
  pick(x, y) {
    const {eye, ahead, right, up, crane: {ground}, canvas: {clientWidth, clientHeight}} = this;
    const u = 2 * x / clientWidth - 1, w = 1 - 2 * y / clientHeight;
    const ray = ahead.map((f, k) => f + u * right[k] + w * up[k]), way = (ground - eye[2]) / ray[2];
    return way > 0 && way < 500 ? eye.map((e, k) => e + way * ray[k]) : null;
  }

  /** Place in the window [pixels] of a point [m], null behind the eye. @param {number[]} point */
  project([x, y, z]) {
    const {camera: m, canvas} = this;
    const [u, v, w] = [0, 1, 3].map(k => m[k] * x + m[4 + k] * y + m[8 + k] * z + m[12 + k]);
    return w > 0.3 * this.scale ? [(1 + u / w) / 2 * canvas.clientWidth, (1 - v / w) / 2 * canvas.clientHeight] : null;
  }

  /** Way in the window from the middle of its free part to a point [m]: to the right and down
   * [pixels]. Behind the eye it is as long as the window, in the direction to turn to.
   * @param {number[]} point */
  wayTo([x, y, z]) {
    const {camera: m, free, canvas: {clientWidth, clientHeight}} = this;
    const [u, v, w] = [0, 1, 3].map(k => m[k] * x + m[4 + k] * y + m[8 + k] * z + m[12 + k]);
    const way = [(u - free.x * w) * clientWidth / 2, -(v - free.y * w) * clientHeight / 2];
    if (w > 0.3 * this.scale) return way.map(pixels => pixels / w);
    const length = Math.hypot(...way) || 1;
    return way.map(pixels => pixels / length * (clientWidth + clientHeight));
  }

  /** Lay out all lines; return how many of their points lie on the ground. @param {Look} look */
  _layLines({goal, radius, aim, night, t}) {
    const {load, crane: {ground}, _path: path, rope: [pivot], _colours: [orange, green, blue]} = this;
    const ink = night ? [0.85, 0.85, 0.85] : [0.1, 0.1, 0.1];
    if (t < this._pathTime) this._pathLength = this._pathTime = 0;
    if (t - this._pathTime >= PATH_SECONDS / PATH_POINTS) {
      this._pathTime = t;
      this._pathLength = Math.min(PATH_POINTS, this._pathLength + 1);
      path.copyWithin(3, 0, 3 * (PATH_POINTS - 1));
      path.set(load);
    }
    this._lineCount = 0;
    if (goal) this._ring(goal, ground, radius, green);
    if (aim) this._ring(aim, ground, 0.5, blue);
    this._ring(load, ground, 0.35 * this.scale, ink);
    for (let i = 0; goal && i < GOAL_DASHES; i++) {
      for (const [share, width] of [[i / GOAL_DASHES, 2.2], [(i + 0.5) / GOAL_DASHES, 0]]) {
        const [x, y] = load.map((from, k) => from + share * (goal[k] - from));
        this._point(x, y, ground, width, green, 0.8);
      }
    }
    const grounded = this._lineCount;
    // From afar the rope is thinner than a pixel.
    this.rope.forEach(([x, y, z], i) =>
      this._point(x, y, z, i < this.rope.length - 1 ? 1.6 : 0, night ? [0.3, 0.3, 0.3] : ink, 1));
    // A plumb line below the trolley shows the swing, one below the load where it is.
    for (let z = pivot[2]; z > ground; z -= 0.9) {
      this._point(pivot[0], pivot[1], z, 1, ink, 0.4);
      this._point(pivot[0], pivot[1], Math.max(z - 0.4, ground), 0, ink, 0.4);
    }
    for (const [place, colour] of [[load, orange], [goal, green], [aim, blue]]) {
      if (!place || !colour) continue;
      this._point(place[0], place[1], place[2], 1.2, colour, 0.9);
      this._point(place[0], place[1], ground, 0, colour, 0.4);
    }
    if (goal) this._ring(goal, goal[2], radius, green);
    if (aim) this._ring(aim, aim[2], 0.5, blue);
    for (let i = 0; i < this._pathLength; i++) {
      const width = i < this._pathLength - 1 ? 2.2 : 0, age = i / this._pathLength;
      this._point(path[3 * i], path[3 * i + 1], path[3 * i + 2], width, orange, 0.75 * (1 - age));
    }
    return grounded;
  }

  /** Lay a point of a line; a width of 0 [pixels] ends the line. @param {number} x @param {number} y
   * @param {number} z @param {number} width @param {number[]} colour @param {number} alpha */
  _point(x, y, z, width, colour, alpha) {
    const to = this._lines, i = LINE_FLOATS * this._lineCount;
    if (this._lineCount >= MAX_LINE_POINTS) return;
    [to[i], to[i + 1], to[i + 2]] = [x, y, z];
    to[i + 3] = width && Math.max(LEAST_WIDTH, width * this.canvas.width / this.canvas.clientWidth);
    [to[i + 4], to[i + 5], to[i + 6], to[i + 7]] = [colour[0], colour[1], colour[2], alpha];
    this._lineCount++;
  }

  /** Lay a level circle. @param {number[]} centre @param {number} z @param {number} radius
   * @param {number[]} colour */
  _ring([x, y], z, radius, colour) {
    for (let i = 0; i <= 40; i++) {
      const c = Math.cos(i * Math.PI / 20), s = Math.sin(i * Math.PI / 20);
      this._point(x + radius * c, y + radius * s, z, i < 40 ? 2.2 : 0, colour, 0.95);
    }
  }

  /** Draw the lines between points. @param {Program} program @param {number} first
   * @param {number} last */
  _drawLines(program, first, last) {
    const {gl} = this;
    this._use(program);
    this._lineArray.bind(first);
    if (!first) gl.bufferSubData(gl.ARRAY_BUFFER, 0, this._lines);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, last - first - 1);
  }
}
