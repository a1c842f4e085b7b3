import { describe, expect, it } from "vitest";
import { History } from "../../src/chart/history";
import type { FlownStep } from "../../src/chart/step_watch";
import { controlLoop } from "../../src/loops";
import { scaledStep } from "../../src/pages/tune/flown_steps";

const attitude = controlLoop("theta");

function flown(before: number, after: number, loop: FlownStep["loop"] = attitude): [History, FlownStep] {
  const history = new History(["estimate.theta"]);
  const time = Float64Array.from({ length: 500 }, (_, k) => k * 0.004);
  const theta = Float32Array.from(time, (t) =>
    t < 1 ? before : before + (after - before) * (1 - Math.exp(-(t - 1) / 0.1)),
  );
  history.append({ time, columns: [theta] });
  const figures = { rise: NaN, settling: NaN, overshoot: NaN, peak: NaN, peakTime: NaN };
  const rest = { peakMoment: NaN, over: false, averaged: 1, changes: 0, response: { since: [], share: [], length: 0 } };
  return [history, { loop, time: 1, before, after, end: Infinity, figures, ...rest }];
}

describe("a flown step", () => {
  it.each([
    [0, 0.1],
    [0.2, -0.1],
  ])("from %d to %d goes from 0 to the goal", (before, after) => {
    const step = scaledStep(...flown(before, after), 0.17, "x")!;
    expect(step.time[0]).toBeCloseTo(0, 6);
    expect(step.theta[0]).toBeCloseTo(0, 5);
    expect(step.theta.at(-1)).toBeCloseTo(0.17, 3);
  });
  it("of another loop, or too small to tell from noise, is none", () => {
    expect(scaledStep(...flown(0, 0.02), 0.17, "x")).toBeUndefined();
    const rate = controlLoop("q");
    expect(scaledStep(...flown(0, 0.2, rate), 0.17, "x")).toBeUndefined();
  });
});
