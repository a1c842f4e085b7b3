// Steps of theta that are flown while one looks, scaled to the step that was predicted.
import type { History } from "../../chart/history";
import type { FlownStep } from "../../chart/step_watch";

/** Response from 0 to the goal; theta [rad]. */
export interface ScaledStep {
  label: string;
  time: readonly number[];
  theta: readonly number[];
}

/** Smallest step [rad]; below it is mostly noise. */
const LEAST = 0.035;
const SHOWN_S = 3;

/** Scale a step of the attitude to go from 0 to `goal` [rad]; undefined for other steps. */
export function scaledStep(history: History, step: FlownStep, goal: number, label: string): ScaledStep | undefined {
  const size = step.after - step.before;
  const theta = history.column("estimate.theta");
  if (step.loop.loop !== "theta" || Math.abs(size) < LEAST || theta === undefined) return undefined;
  const until = Math.min(step.end, step.time + SHOWN_S);
  const [times, values]: [number[], number[]] = [[], []];
  for (let row = history.rowAt(step.time); row < history.last && history.time(row) <= until; row += 1) {
    const value = theta.at(row);
    if (!Number.isFinite(value)) continue;
    times.push(history.time(row) - step.time);
    values.push(((value - step.before) * goal) / size);
  }
  return times.length < 2 ? undefined : { label, time: times, theta: values };
}
