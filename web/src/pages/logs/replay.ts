// A flight again: where the drone was at a time, and how that time goes on.

import type { LogReplay } from "../../api/logs";
import { pairs, type Place, type Pose, type Wanted } from "../../scene/pose";
import { float32s } from "./unpack";

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10] as const;

/** Return the replay's time after `passed` [s]. */
export function advance(
  time: number,
  passed: number,
  speed: number,
  [start, end]: readonly [number, number],
): { time: number; over: boolean } {
  // A tab that was asleep does not jump ahead by the time that it slept.
  const next = Math.max(start, time) + Math.min(passed, 0.25) * speed;
  return next >= end ? { time: end, over: true } : { time: next, over: false };
}

export class Replay {
  private readonly columns: Record<string, Float32Array>;

  constructor(private readonly told: Pick<LogReplay, "start" | "rate" | "count" | "columns">) {
    this.columns = Object.fromEntries(Object.entries(told.columns).map(([name, text]) => [name, float32s(text)]));
  }

  /** Interpolate a column at a time [s]; NaN outside. */
  at(name: string, time: number): number {
    const column = this.columns[name];
    if (column === undefined) return NaN;
    const place = (time - this.told.start) * this.told.rate;
    const row = Math.floor(place);
    if (row < 0 || row >= column.length) return NaN;
    const [here, next] = [column[row]!, column[Math.min(row + 1, column.length - 1)]!];
    return Number.isFinite(next) ? here + (place - row) * (next - here) : here;
  }

  private known(name: string, time: number): number | undefined {
    const value = this.at(name, time);
    return Number.isFinite(value) ? value : undefined;
  }

  pose(time: number): Pose {
    const [x = 0, theta = 0, T = 0, M = 0] = ["x", "theta", "T", "M"].map((name) => this.known(name, time));
    return { x, theta, ...pairs(T, M) };
  }

  /** Return the true place; undefined for a real rig. */
  truth(time: number): Place | undefined {
    const [x, theta] = [this.known("x_true", time), this.known("theta_true", time)];
    return x === undefined || theta === undefined ? undefined : { x, theta };
  }

  /** Return the set-points of a mode. */
  wanted(time: number, mode: string): Wanted {
    return {
      theta: ["attitude", "velocity", "position"].includes(mode) ? this.known("theta0", time) : undefined,
      x: mode === "position" ? this.known("x0", time) : undefined,
    };
  }
}
