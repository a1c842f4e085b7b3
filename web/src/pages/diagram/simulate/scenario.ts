// What is flown: a step of the set-point of the template's loop, from hover.
import type { Value } from "../../../wasm/signal";

export interface Scenario {
  readonly mode: string;
  /** The step [SI], and when it comes [s]. */
  readonly size: number;
  readonly at: number;
  readonly thrust: number;
  readonly rings: boolean;
  readonly noise: boolean;
  readonly seconds: number;
  readonly rig: "lab" | "paper";
}

/** A mode: its number on board, the set-point that steps, what is to follow it, and the unit of both. */
export interface Mode {
  readonly name: string;
  readonly number: number;
  readonly setpoint: string;
  readonly follows: string;
  readonly unit: string;
  readonly size: number;
  readonly most: number;
  readonly rings: boolean;
}

const RATE: Mode = {
  name: "rate",
  number: 2,
  setpoint: "q0",
  follows: "true_q",
  unit: "rad/s",
  size: 0.35,
  most: 3,
  rings: true,
};
const ATTITUDE: Mode = {
  name: "attitude",
  number: 3,
  setpoint: "theta0",
  follows: "true_theta",
  unit: "rad",
  size: (10 * Math.PI) / 180,
  most: 0.85,
  rings: true,
};
const VELOCITY: Mode = {
  name: "velocity",
  number: 4,
  setpoint: "v0",
  follows: "true_v",
  unit: "m/s",
  size: 0.1,
  most: 0.5,
  rings: false,
};
const POSITION: Mode = {
  name: "position",
  number: 5,
  setpoint: "x0",
  follows: "true_x",
  unit: "m",
  size: 0.1,
  most: 0.4,
  rings: false,
};

/** What each template can be flown in; the first is where one begins. */
export const MODES: Readonly<Record<string, readonly Mode[]>> = {
  attitude_control: [ATTITUDE, RATE, VELOCITY, POSITION],
  position_control: [POSITION, VELOCITY],
  motor_control: [ATTITUDE, RATE, POSITION, VELOCITY],
};

export const HOVER = 0.4;
export const PERIOD = 0.004; // s

export function modesOf(template: string): readonly Mode[] {
  return MODES[template] ?? [ATTITUDE];
}

export function beginWith(template: string): Scenario {
  const mode = modesOf(template)[0]!;
  return {
    mode: mode.name,
    size: mode.size,
    at: 0.2,
    thrust: HOVER,
    rings: mode.rings,
    noise: false,
    seconds: 3,
    rig: "lab",
  };
}

/** The inputs and parameters of the loop for a scenario. */
export function flown(scenario: Scenario, template: string, setpoints: readonly string[]) {
  const mode = modesOf(template).find((one) => one.name === scenario.mode) ?? modesOf(template)[0]!;
  const steps = Math.round(scenario.seconds / PERIOD);
  const inputs: Record<string, Value> = Object.fromEntries(setpoints.map((name) => [name, 0]));
  inputs["mode"] = mode.number;
  inputs["thrust"] = scenario.thrust;
  const from = Math.round(scenario.at / PERIOD);
  const column = Float64Array.from({ length: steps }, (_, step) => (step < from ? 0 : scenario.size));
  const parameters: Record<string, Value> = { "rig.noise": scenario.noise ? 1 : 0, "rig.rings": scenario.rings };
  return { mode, steps, inputs, columns: { [mode.setpoint]: column }, parameters };
}
