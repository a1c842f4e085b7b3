import { describe, expect, it } from "vitest";
import { figure, live, tick } from "../src/chart/numbers";
import {
  boundsMistake,
  editableNumber,
  brief,
  raised,
  readNumber,
  shownNumber,
  shownValue,
  withSpread,
  written,
} from "../src/design/units";

describe("units", () => {
  it("shows degrees and keeps radians", () => {
    expect(shownValue(Math.PI / 18, "rad")).toBe("10.00\u00a0deg");
    expect(readNumber("10", "rad")).toBeCloseTo(Math.PI / 18, 15);
    expect(shownValue(0.42, "%")).toBe("42%");
    expect(shownNumber(NaN, "m")).toBe("–");
    expect(shownNumber(-1e-9, "m")).toBe("0.000");
  });
  it("writes a value with the decimals of its standard deviation", () => {
    const pairs = [
      [277.5123, 20.4],
      [0.008495, 0.0016],
      [-0.01025, 0.037],
      [123.4, 123.4],
    ] as const;
    expect(pairs.map(([value, sigma]) => withSpread(value, sigma))).toEqual(["278", "0.0085", "\u22120.010", "123"]);
    expect(pairs.map(([, sigma]) => withSpread(sigma, sigma))).toEqual(["20", "0.0016", "0.037", "123"]);
    expect([withSpread(2.28, null), withSpread(null, 1)]).toEqual(["2.280", "–"]);
  });
  it("gives back what was typed, to the digits that it shows", () => {
    for (const [text, unit] of [
      ["12.5", "rad"],
      ["-0.25", "m"],
      ["0.0004", ""],
      ["-7.3", "rad/s"],
      ["1e-7", ""],
    ] as const) {
      expect(Number(editableNumber(readNumber(text, unit), unit))).toBeCloseTo(Number(text), 9);
    }
  });
  it("reads a decimal comma and a typographic minus, and nothing else", () => {
    expect(readNumber("\u22120,5", "m")).toBe(-0.5);
    for (const text of ["", "ten", "1 2", "5deg"]) expect(readNumber(text, "m")).toBeNaN();
  });
  it("takes a bound itself, and says bounds in the unit of the screen", () => {
    const most = (50 * Math.PI) / 180;
    expect(boundsMistake(readNumber("50", "rad"), "rad", -most, most)).toBe("");
    expect(boundsMistake(readNumber("50.1", "rad"), "rad", -most, most)).toBe("From \u221250 to 50 deg.");
    expect(boundsMistake(-1, "s", 0, Infinity)).toBe("At least 0 s.");
    expect(boundsMistake(NaN, "s", 0, 1)).toBe("Give a number.");
  });
  it("writes a parameter of a diagram briefly", () => {
    expect(brief("0.0009334224953218762 s2/rad, 0 to 0.05")).toBe("0.0009334 s²/rad, 0 to 0.05");
    expect(brief("20.0 rad/s, 0 to inf")).toBe("20 rad/s, at least 0");
    expect(brief("-1.5 V, -inf to 0, fixed")).toBe("\u22121.5 V, at most 0, fixed");
    expect(brief("")).toBe("");
  });
  it("writes a square as one", () => {
    expect([raised("s^2/rad"), raised("rad/s2"), raised("m/s"), raised("rad")]).toEqual([
      "s²/rad",
      "rad/s²",
      "m/s",
      "rad",
    ]);
  });
  it("keeps the decimals of what changes while it is read", () => {
    expect([
      live(0.00081, "deg"),
      live(-8.13e-7, "deg"),
      live(-12.3, "deg"),
      live(-0.0178, ""),
      live(NaN, "m"),
    ]).toEqual(["0.001", "0.000", "\u221212.300", "\u22120.0178", "–"]);
  });
  it("writes an axis as the values beside it", () => {
    expect([-10, -0.25, 0.1 + 0.2, -0, 1e-7, null].map(tick)).toEqual([
      "\u221210",
      "\u22120.25",
      "0.3",
      "0",
      "1e-7",
      "",
    ]);
    expect([figure(-10), shownNumber(-10, "m"), written("-10")].map((text) => text[0])).toEqual(
      Array(3).fill(tick(-10)[0]),
    );
    expect(figure(-1e-7)).toBe("\u22121.00e-7");
  });
});
