import { describe, expect, it } from "vitest";
import { JsonFault, readJson, realText, writeJson } from "../../src/pages/diagram/model/json_text";

describe("a real number", () => {
  // What Python 3's repr gives.
  it.each([
    [0, "0.0"],
    [-0, "-0.0"],
    [1, "1.0"],
    [-1.5, "-1.5"],
    [0.0001, "0.0001"],
    [0.00009, "9e-05"],
    [1.25e-7, "1.25e-07"],
    [5e-324, "5e-324"],
    [1e15, "1000000000000000.0"],
    [9999999999999998, "9999999999999998.0"],
    [1e16, "1e+16"],
    [1.5e16, "1.5e+16"],
    [123456789012345680, "1.2345678901234568e+17"],
    [1e21, "1e+21"],
    [1.7976931348623157e308, "1.7976931348623157e+308"],
    [0.1, "0.1"],
    [1234.5678, "1234.5678"],
  ])("%d is written %s", (value, text) => {
    expect(realText(value)).toBe(text);
    expect(Number(text)).toBe(value);
  });
  it("is refused when it is not finite", () => {
    expect(() => realText(NaN)).toThrow(RangeError);
  });
});

describe("JSON", () => {
  it("keeps 1.0 and 1 apart, and whole numbers of any length", () => {
    const text = "[1.0, 1, 18446744073709551615]";
    expect(writeJson(readJson(text))).toBe(text);
  });
  it("makes a number's other spellings Python's", () => {
    expect(writeJson(readJson("[1.50, 1E3, -0, 0.000010]"))).toBe("[1.5, 1000.0, 0, 1e-05]");
  });
  it("keeps a key called __proto__ a key", () => {
    expect(writeJson(readJson('{"__proto__": {"a": 1}}'))).toBe('{"__proto__": {"a": 1}}');
  });
  it.each(["", "{", "[1,]", "{a: 1}", '{"a": 1, "a": 2}', "[1] 2", '"\\x"', "1e999", "NaN", "[".repeat(5000)])(
    "refuses %s",
    (text) => {
      expect(() => readJson(text)).toThrow(JsonFault);
    },
  );
  it("breaks what is longer than 80 characters into lines", () => {
    const text = writeJson({ a: "x".repeat(70), b: ["y".repeat(76)], c: "😀".repeat(20) });
    expect(text.split("\n")).toHaveLength(5);
  });
});
