import { describe, expect, it } from "vitest";
import { aligned, type Alignment } from "../../src/pages/diagram/model/align";

const boxes = new Map([
  ["a", { x: 0, y: 0, width: 50, height: 40 }],
  ["b", { x: 200, y: 10, width: 100, height: 60 }],
  ["c", { x: 90, y: 30, width: 50, height: 40 }],
]);
const places = (how: Alignment): unknown => Object.fromEntries(aligned(boxes, how));

describe("aligned", () => {
  it("edges meet at the outermost", () => {
    expect(places("left")).toEqual({ a: [0, 0], b: [0, 10], c: [0, 30] });
    expect(places("right")).toEqual({ a: [250, 0], b: [200, 10], c: [250, 30] });
    expect(places("top")).toEqual({ a: [0, 0], b: [200, 0], c: [90, 0] });
    expect(places("bottom")).toEqual({ a: [0, 30], b: [200, 10], c: [90, 30] });
  });
  it("centres meet in the middle of all", () => {
    expect(places("centre")).toEqual({ a: [125, 0], b: [100, 10], c: [125, 30] });
    expect(places("middle")).toEqual({ a: [0, 15], b: [200, 5], c: [90, 15] });
  });
  it("gaps are alike between the first and the last, which stay", () => {
    expect(places("across")).toEqual({ a: [0, 0], b: [200, 10], c: [100, 30] });
    const down = aligned(new Map([...boxes, ["d", { x: 0, y: 300, width: 10, height: 10 }]]), "down");
    const tops = [...down.values()].map(([, y]) => y).sort((a, b) => a - b);
    expect(tops).toEqual([0, 93, 207, 300]); // the gaps are (310 - 40 - 60 - 40 - 10) / 3
  });
});
