import type { Loop } from "./api/drones";
import { screenUnit } from "./design/units";

/** Control loops from the moment without a loop to the outermost. `loop` names set-points, as in `setpoint.theta`. */
const ROWS = [
  { loop: "M", name: "open-loop", symbol: "M", label: "Moment M, no loop closed", short: "Moment", unit: "-" },
  { loop: "q", name: "rate", symbol: "q", label: "Pitch rate q", short: "Rate", unit: "rad/s" },
  { loop: "theta", name: "attitude", symbol: "θ", label: "Pitch θ", short: "Pitch", unit: "rad" },
  { loop: "v", name: "velocity", symbol: "v", label: "Velocity v", short: "Velocity", unit: "m/s" },
  { loop: "x", name: "position", symbol: "x", label: "Position x", short: "Position", unit: "m" },
] as const satisfies readonly { loop: Loop; [key: string]: string }[];

/**
 * Control loop with its index into signals.MODES. A loop that moves the cart commands pitch and thrust; the rings may
 * lock the cart.
 */
export type ControlLoop = (typeof ROWS)[number] & { mode: number; movesCart: boolean };

export const CONTROL_LOOPS: readonly ControlLoop[] = ROWS.map((row, k) => ({ ...row, mode: k + 1, movesCart: k >= 3 }));

/** Find a loop by its set-point, name or mode; undefined for a mode without a loop. */
export function controlLoop(key: Loop): ControlLoop;
export function controlLoop(key: string | number): ControlLoop | undefined;
export function controlLoop(key: string | number): ControlLoop | undefined {
  return CONTROL_LOOPS.find((one) => one.loop === key || one.name === key || one.mode === key);
}

/** Convert a value of a loop to the unit of the screen. */
export function onScreen(loop: ControlLoop, value: number): number {
  return value * screenUnit(loop.unit).factor;
}
