// What one reads off a step response. The definitions are those of twodof.models.lti.step_figures and
// twodof.report.step_responses, and a test holds these against what they give.

export const SETTLED = 0.05;

export const SETTLING =
  "Until the mean response stays within 5 % of the step: that of the loop's steps under the same parameters";

/** Least time [s] of both levels of a step. */
export const HELD = 0.25;

/** Time between two rows at the full rate [s]. */
const PERIOD = 0.004;

/** Longest response [s] from which figures are read; later than that a gust moves it, and not the step. */
export const WINDOW: Record<string, number> = { q: 3, theta: 3, v: 4, x: 8 };

/** M reacts at once, and is stamped up to half a period before the set-point [s]. */
const EARLY = 0.002;

/** Times [s] from the step, overshoot as a share of it; NaN if not reached. */
export interface StepFigures {
  rise: number;
  settling: number;
  overshoot: number;
  peak: number;
}

/** A step of a set-point at `time` [s], from `before` to `after`; over at `end` [s]. */
export interface Step {
  time: number;
  before: number;
  after: number;
  end: number;
}

function firstCrossing(t: ArrayLike<number>, z: Float64Array, level: number): number {
  const k = z.findIndex((value) => value >= level);
  if (k < 0) return NaN;
  if (k === 0) return t[0]!;
  return t[k - 1]! + ((level - z[k - 1]!) / (z[k]! - z[k - 1]!)) * (t[k]! - t[k - 1]!);
}

/**
 * Figures of a response `y` sampled at `t` [s] (0 at the step) to a step from `start` to `final`, which differ: rise
 * from 10 to 90 %, settling the last time outside +- `band` of the step, both interpolated between samples.
 */
export function stepFigures(
  t: ArrayLike<number>,
  y: ArrayLike<number>,
  start: number,
  final: number,
  band = SETTLED,
): StepFigures {
  const z = Float64Array.from(y, (value) => (value - start) / (final - start));
  let top = 0;
  let out = -1;
  z.forEach((value, k) => {
    if (value > z[top]!) top = k;
    if (Math.abs(value - 1) > band) out = k;
  });
  let settling = t[0] ?? NaN;
  if (out === z.length - 1) settling = NaN;
  else if (out >= 0) {
    const edge = 1 + (z[out]! > 1 ? band : -band);
    settling = t[out]! + ((edge - z[out]!) / (z[out + 1]! - z[out]!)) * (t[out + 1]! - t[out]!);
  }
  return {
    rise: firstCrossing(t, z, 0.9) - firstCrossing(t, z, 0.1),
    settling,
    overshoot: Math.max(0, (z[top] ?? NaN) - 1),
    peak: y[top] ?? NaN,
  };
}

export function peakMoment(time: ArrayLike<number>, moment: ArrayLike<number>, step: Step): number {
  let peak = NaN;
  for (let k = 0; k < time.length; k += 1) {
    const inside = time[k]! >= step.time - EARLY && time[k]! <= step.end - EARLY;
    if (inside && !(peak >= Math.abs(moment[k]!))) peak = Math.abs(moment[k]!);
  }
  return peak;
}

/** A response as a share of its step, at times `since` [s] from it, up to `length` [s]. */
export interface Response {
  since: readonly number[];
  share: readonly number[];
  length: number;
}

/** Return the settling time [s] of the mean response, and of how many: those that last as long as half of them. */
export function meanSettling(group: readonly Response[]): { settling: number; averaged: number } {
  const lasting = group.map((one) => one.length).sort((a, b) => a - b)[(group.length - 1) >> 1] ?? 0;
  const inside = group.filter((one) => one.length >= lasting - 1e-6);
  const time = Array.from({ length: Math.floor(lasting / PERIOD + 1e-6) + 1 }, (_, k) => PERIOD * k);
  const mean = new Float64Array(time.length);
  for (const { since, share } of inside) {
    let k = 0;
    time.forEach((at, row) => {
      while (k < since.length && since[k]! <= at) k += 1;
      const [low, high] = [Math.max(k - 1, 0), Math.min(k, since.length - 1)];
      const part = high > low ? Math.max(0, (at - since[low]!) / (since[high]! - since[low]!)) : 0;
      mean[row]! += (share[low]! + part * (share[high]! - share[low]!)) / inside.length;
    });
  }
  return { settling: time.length < 2 ? NaN : stepFigures(time, mean, 0, 1).settling, averaged: inside.length };
}
