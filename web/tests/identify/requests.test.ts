import { describe, expect, it } from "vitest";
import type { ExperimentRow, OutputCurves, ResidualTest } from "../../src/api/identification";
import {
  byLoop,
  experimentRequest,
  experimentOf,
  fitRequest,
  latestOf,
  windowOf,
} from "../../src/pages/identify/requests";
import { fitSeries, fitWords, residualSeries, strength, testSeries, testWords } from "../../src/pages/identify/curves";

const NAMES = ["impulse", "doublet", "velocity-doublet", "attitude-steps"];
const FLIGHTS = [
  "2026-11-23-18-10-00-velocity-doublet.mcap",
  "2026-11-23-18-05-00-drone-1.mcap",
  "2026-11-23-18-03-00-doublet-2.mcap",
  "2026-11-23-18-02-00-impulse.mcap",
];

describe("the log that fits", () => {
  it("is told by its name, the longest experiment first", () => {
    expect(FLIGHTS.map((one) => experimentOf(one, NAMES))).toEqual([
      "velocity-doublet",
      undefined,
      "doublet",
      "impulse",
    ]);
    expect(latestOf(FLIGHTS, "doublet", NAMES)).toBe(FLIGHTS[2]);
  });
  it("is asked for without what is empty", () => {
    const given = { log: "a", kind: "", structure: "auto", impulse: "", others: ["a", "b"], disturbance: "auto" };
    expect(fitRequest({ ...given, window: undefined })).toEqual({
      log: "a",
      structure: "auto",
      disturbance: "auto",
      others: ["b"],
    });
    expect(fitRequest({ ...given, kind: "impulse", impulse: "i", window: [1, 2] })).toMatchObject({ kind: "impulse" });
    expect(fitRequest({ ...given, kind: "impulse", impulse: "i", window: [1, 2] })).not.toHaveProperty("impulse");
    expect(fitRequest({ ...given, kind: "doublet", impulse: "i", window: [1, 2] })).toMatchObject({
      impulse: "i",
      window: [1, 2],
    });
  });
  it.each([
    ["", "", undefined],
    ["1,5", "3", [1.5, 3]],
    ["3", "1", "The window must end after it begins."],
    ["x", "3", "Give both times of the window in seconds, or none."],
    ["", "3", "Give both times of the window in seconds, or none."],
  ])("in a window from %j to %j", (from, to, found) => expect(windowOf(from, to)).toEqual(found));
});

describe("an experiment", () => {
  const row = { name: "doublet", kind: "doublet", mode: "open-loop" } as ExperimentRow;
  it("has its own excitation only where one was built", () => {
    expect(experimentRequest(row, undefined)).toEqual({ name: "doublet" });
    const own = { kind: "3-2-1-1", version: 1 };
    expect(experimentRequest(row, own)).toEqual({ name: "doublet", excitation: own });
  });
  it("stands by its loop", () => {
    const [open, closed] = byLoop([row, { ...row, name: "attitude-steps", kind: "attitude", mode: "attitude" }]);
    expect(open![1].map((one) => one.name)).toEqual(["doublet"]);
    expect(closed![1].map((one) => one.name)).toEqual(["attitude-steps"]);
  });
});

describe("curves", () => {
  const output: OutputCurves = {
    name: "q",
    unit: "rad/s",
    record: "log",
    validation: false,
    fit_percent: 98,
    fit_percent_ahead: null,
    rmse: 0.01,
    time: [0, 0.004],
    measured: [0, null],
    residual: [0.1, -0.1],
    greybox: [0, Math.PI],
  };
  it("say in closed loop how well the next sample is foretold", () => {
    expect(fitWords(output)).toBe("FIT 98.0 %, 2 % of the motion unexplained");
    expect(fitWords({ fit_percent: -169.7, fit_percent_ahead: 97.3 })).toBe(
      "FIT 97.3 % one sample ahead; drawn is the model without the gusts, -169.7 %",
    );
  });
  it("are in degrees, and a gap is none of 0", () => {
    const [measured, greybox] = fitSeries(output);
    expect(measured!.y[1]).toBeNaN();
    expect(greybox!.y[1]).toBeCloseTo(180);
    expect(residualSeries(output)[0]!.kind).toBe("grey-box");
    expect(residualSeries({ ...output, greybox: undefined, simple: [0, 0] } as unknown as OutputCurves)[0]!.kind).toBe(
      "simple",
    );
  });
  it("of a test have the bound on both sides, and words", () => {
    const test: ResidualTest = {
      output: "q",
      against: "itself",
      lags: [1, 2],
      value: [0.3, 0],
      bound: [0.1, 0.1],
      passed: false,
      outside: 1,
      allowed: 0,
    };
    expect(testSeries(test)[0]!.band!.low[0]).toBeCloseTo(-0.1);
    expect(testWords(test)).toContain("not white (1 of 2");
    expect(testWords({ ...test, passed: true, against: "M" })).toBe("q: the residual is independent of M");
    expect([strength(null), strength(-0.5), strength(2)]).toEqual([0, 0.5, 1]);
  });
});
