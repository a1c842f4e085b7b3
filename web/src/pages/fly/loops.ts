import type { Loop } from "../../api/drones";
import { shownValue } from "../../design/units";
import { controlLoop, type ControlLoop } from "../../loops";

/** Ranges of a loop's set-point, in SI. */
interface Ranges {
  /** Largest value of the slider, and the step of its arrow keys. */
  slides: number;
  step: number;
  /** Largest value that can be typed. */
  most: number;
  /** Buttons. */
  steps: readonly number[];
}

const DEG = Math.PI / 180;
const degrees = (values: number[]) => values.map((value) => value * DEG);
const STEPS = [-0.2, -0.1, 0, 0.1, 0.2];
const RANGES: Readonly<Record<Loop, Ranges>> = {
  theta: { slides: 20 * DEG, step: 0.5 * DEG, most: 50 * DEG, steps: degrees([-10, -5, 0, 5, 10]) },
  x: { slides: 0.35, step: 0.005, most: 0.4, steps: STEPS },
  v: { slides: 0.5, step: 0.01, most: 2, steps: STEPS },
  q: { slides: 60 * DEG, step: DEG, most: 180 * DEG, steps: degrees([-30, -15, 0, 15, 30]) },
  M: { slides: 0.1, step: 0.001, most: 1, steps: [-0.03, -0.01, 0, 0.01, 0.03] },
};

/** Return a loop with the ranges of its controls. */
export const loopRow = (loop: Loop): ControlLoop & Ranges => ({ ...controlLoop(loop), ...RANGES[loop] });

/** Loops in the order of the tabs. */
export const LOOPS = (Object.keys(RANGES) as Loop[]).map(loopRow);

/** Describe the set-point that the drone reports, whichever client sent it; `value` reads a column of telemetry. */
export function followed(value: (column: string) => number, armed: boolean): string {
  const row = controlLoop(value("state.mode"));
  if (!armed || row === undefined) return "follows no set-point";
  if (row.loop === "M") return "moment command, no loop closed";
  return `follows ${row.short.toLowerCase()} ${shownValue(value(`setpoint.${row.loop}`), row.unit)}`;
}
