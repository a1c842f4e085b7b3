import { expect, it } from "vitest";
import { testWords } from "../../src/pages/identify/curves";

it("says why a residual is not white", () => {
  const test = { output: "q", against: "itself", lags: [1, 2, 3], value: [], bound: [], passed: false, allowed: 1 };
  expect(testWords({ ...test, outside: 2 })).toContain("2 of 3 lags outside, 1 by chance");
  expect(testWords({ ...test, outside: 1 })).toContain("a lag lies further outside than by chance");
});
