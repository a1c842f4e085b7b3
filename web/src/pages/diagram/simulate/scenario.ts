// What is flown: a step of the set-point of the template's loop, from hover.
import { controlLoop, type ControlLoop } from "../../../loops";
import type { Value } from "../../../wasm/signal";

export interface Scenario {
  readonly mode: string;
  /** Size of the step [SI] and its time [s]. */
  readonly size: number;
  readonly at: number;
  readonly thrust: number;
  readonly rings: boolean;
  readonly noise: boolean;
  readonly seconds: number;
  readonly rig: "lab" | "paper";
}

/** Loop that is simulated: the step that its set-point begins with, its bound, and whether the rings are locked. */
interface Mode {
  readonly loop: ControlLoop;
  readonly size: number;
  readonly most: number;
  readonly rings: boolean;
}

const RATE: Mode = { loop: controlLoop("q"), size: 0.35, most: 3, rings: true };
const ATTITUDE: Mode = { loop: controlLoop("theta"), size: (10 * Math.PI) / 180, most: 0.85, rings: true };
const VELOCITY: Mode = { loop: controlLoop("v"), size: 0.1, most: 0.5, rings: false };
const POSITION: Mode = { loop: controlLoop("x"), size: 0.1, most: 0.4, rings: false };

/** Modes of each template; the first is the initial one. */
const MODES: Readonly<Record<string, readonly Mode[]>> = {
  attitude_control: [ATTITUDE, RATE, VELOCITY, POSITION],
  position_control: [POSITION, VELOCITY],
  motor_control: [ATTITUDE, RATE, POSITION, VELOCITY],
};

const HOVER = 0.4;
export const PERIOD = 0.004; // s

export function modesOf(template: string): readonly Mode[] {
  return MODES[template] ?? [ATTITUDE];
}

export function modeOf(template: string, name: string): Mode {
  const modes = modesOf(template);
  return modes.find((one) => one.loop.name === name) ?? modes[0]!;
}

export function beginWith(template: string): Scenario {
  const mode = modesOf(template)[0]!;
  return {
    mode: mode.loop.name,
    size: mode.size,
    at: 0.2,
    thrust: HOVER,
    rings: mode.rings,
    noise: false,
    seconds: 3,
    rig: "lab",
  };
}

export function flown(scenario: Scenario, template: string, setpoints: readonly string[]) {
  const { loop } = modeOf(template, scenario.mode);
  const steps = Math.round(scenario.seconds / PERIOD);
  const inputs: Record<string, Value> = Object.fromEntries(setpoints.map((name) => [name, 0]));
  inputs["mode"] = loop.mode;
  inputs["thrust"] = scenario.thrust;
  const from = Math.round(scenario.at / PERIOD);
  const column = Float64Array.from({ length: steps }, (_, step) => (step < from ? 0 : scenario.size));
  const parameters: Record<string, Value> = { "rig.noise": scenario.noise ? 1 : 0, "rig.rings": scenario.rings };
  return { loop, steps, inputs, columns: { [`${loop.loop}0`]: column }, parameters };
}
