// What is typed into the field of an argument, as JSON keeps it.
import { expect, test } from "vitest";
import { readArgument } from "../../src/pages/diagram/model/argument";
import { readJson, writeJson } from "../../src/pages/diagram/model/json_text";

/** What is kept, as text, or why not. */
function read(typed: string, value: string, given = value): string {
  const found = readArgument(typed, readJson(value), readJson(given));
  return "refused" in found ? found.refused : writeJson(found.value);
}

test.each([
  ["2", "1.0", "2.0"],
  ["2,5", "1.0", "2.5"],
  [".5", "1.0", "0.5"],
  ["\u22123", "1.0", "-3.0"],
  ["7", "2", "7"],
  ["0.5", "2", "0.5"],
  ["-inf", "1.0", '{"float": "-inf"}'],
])("a number: %s in the place of %s is %s", (typed, value, kept) => {
  expect(read(typed, value).replace(/[{}] | [{}]/g, (brace) => brace.trim())).toBe(kept);
});

test.each([
  ["[-1, 0, 1]", "[0.0, 1.0]", "[-1.0, 0.0, 1.0]"],
  ["[-1 0 1]", "[0.0, 1.0]", "[-1.0, 0.0, 1.0]"],
  ["-1 0.5 1", "[0.0, 1.0]", "[-1.0, 0.5, 1.0]"],
  ["[1 2; 3 4]", "[[1.0]]", "[[1.0, 2.0], [3.0, 4.0]]"],
  ["[1 2]", "1.0", "[1.0, 2.0]"],
  ["0 2", "[0]", "[0, 2]"],
  ["a b, c", '["a", "b"]', '["a", "b", "c"]'],
])("a list or rows, as in Python or in MATLAB: %s", (typed, value, kept) => {
  expect(read(typed, value)).toBe(kept);
});

test("the kind of the argument decides, not what was typed there before", () => {
  expect(read("-0.4, 0.4", "null")).toBe("[-0.4, 0.4]");
  expect(read("[-0.4, 0.4]", '"-0.4 to 0.4"', "null")).toBe("[-0.4, 0.4]");
  expect(read("none", "[-0.4, 0.4]", "null")).toBe("null");
  expect(read("", "[1.0]", "null")).toBe("null");
  expect(read("+-", '"++"')).toBe('"+-"');
  expect(read("saturate", "null")).toBe('"saturate"');
});

test.each([
  ["1.2.3", "1.0", "Give a number."],
  ["", "1.0", "Give a number."],
  ["gain", "1.0", "Give a number."],
  ["[1 2", "[0.0, 1.0]", "Give numbers, such as [1 2 3], or rows, such as [1 2; 3 4]."],
  ["1 to 2", "null", "Give numbers, such as [1 2 3], or rows, such as [1 2; 3 4], or none."],
])("%s in the place of %s is refused", (typed, value, why) => {
  expect(read(typed, value)).toBe(why);
});
