import { describe, expect, it } from "vitest";
import { JsonFault, readJson, real, writeJson } from "../../src/pages/diagram/model/json_text";

describe("a real number", () => {
  it.each([
    [0, "0.0"],
    [-0, "-0.0"],
    [1, "1.0"],
    [-1.5, "-1.5"],
    [5e-324, "5e-324"],
    [1e16, "10000000000000000.0"],
    [1e21, "1e+21"],
    [1.7976931348623157e308, "1.7976931348623157e+308"],
  ])("%d is written %s", (value, text) => {
    expect(real(value).text).toBe(text);
    expect(real(value).value).toBe(value);
  });
});

describe("JSON", () => {
  it.each([
    "[1.0, 1, 18446744073709551615, -0.0, 1e-05, 1E+3]",
    '{"__proto__": {"a": 1}, "n1.0": "n1.0", "s": "s: 1.0", "1.0": "\\"2.0\\": 3"}',
    '[null, true, false, [], {}, "", "ä 😀 \\\\", "\\n1.0"]',
  ])("is written as it was read: %s", (text) => {
    expect(writeJson(readJson(text))).toBe(text);
  });
  it.each(["", "{", "[1,]", "{a: 1}", "[1] 2", '"\\x"', "NaN"])("refuses %s", (text) => {
    expect(() => readJson(text)).toThrow(JsonFault);
  });
});
