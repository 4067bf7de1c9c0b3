// Types of the numbers that cranedyn.export.driving_page writes and that the worker sends.

/** One visual of the crane in the frame of a joint, -1 for the world. */
interface Shape {
  joint: number;
  kind: string;
  size: number[];
  rotation: number[];
  translation: number[];
  colour: number[];
  payload: boolean;
  vertices?: number[];
  triangles?: number[];
}

/** An obstacle as flat lists of corners [m] and of their indices. */
interface Solid {
  name: string;
  zone: boolean;
  vertices: number[];
  triangles: number[];
}

interface Exercise extends TaskData {
  /** Obstacles; null for those of the site. */
  solids: Solid[] | null;
  blind: boolean;
  best: {time: number; swing: number; energy: number} | null;
  /** Why a task that is planned has no score. */
  no_best: string;
}

interface ViewData extends Omit<PageData, "tasks" | "crane" | "sliders"> {
  title: string;
  tasks: Exercise[];
  crane: CraneData & {shapes: Shape[]; ground: number; start: number[];
    rates: number[]; efforts: number[]};
  assistances: {name: string; label: string; text: string}[];
  sliders: {name: string; label: string; unit: string; least: number; most: number; value: number}[];
  site: {name: string; solids: Solid[]} | null;
  colours: Record<string, string>;
}

/** What a picture shows: view, time [s], a task's goal with its radius, the place of a click [m]. */
interface Look {
  view: string;
  night: boolean;
  t: number;
  goal: number[] | null;
  radius: number;
  aim: number[] | null;
}

/** A message of the worker, at most 60 a second. */
interface State {
  type: string;
  t: number;
  q: number[];
  v: number[];
  effort: number[];
  swing: number;
  height: number;
  radius: number;
  rope_force: number | null;
  work: number;
  assist: string;
  stopped: boolean;
  goal: number[] | null;
  ratio: number;
  /** Length to which the hoist goes [m]. */
  cable: number | null;
  utilisation: number | null;
  event: {text: string} | null;
  replaying: boolean;
  task: {name: string; time: number; largest_swing: number; energy: number; done: boolean} | null;
}

interface Curve {
  label: string;
  colour: string;
  dash: number[];
}

interface Plot {
  title: string;
  unit: string;
  /** Least end of its axis. */
  least: number;
  curves: Curve[];
}

/** A program of the picture with the places of its uniforms. */
interface Program {
  program: WebGLProgram;
  uniforms: Record<string, WebGLUniformLocation | null>;
}

interface Programs {
  body: Program;
  back: Program;
  line: Program;
}
