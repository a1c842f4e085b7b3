import { describe, expect, it } from "vitest";
import { Pyramid } from "../src/chart/draw/pyramid";
import { History } from "../src/chart/history";

/** Numbers that come again at each run. */
function random(seed: number): () => number {
  let state = seed;
  return () => (state = (Math.imul(state, 1664525) + 1013904223) >>> 0) / 2 ** 32;
}

describe("a pyramid", () => {
  it("finds least and greatest as a look at each sample does, also after the ring has gone round", () => {
    const next = random(1);
    for (const capacity of [5, 64, 513, 4096]) {
      const pyramid = new Pyramid(capacity);
      const kept: number[] = [];
      for (let k = 0; k < 3 * capacity + 7; k += 1) {
        const value = next() < 0.1 ? NaN : Math.fround(next() * 2 - 1);
        kept.push(value);
        pyramid.put(k, value);
      }
      for (let trial = 0; trial < 300; trial += 1) {
        const oldest = kept.length - capacity;
        const from = oldest + Math.floor(next() * capacity);
        const to = from + Math.floor(next() * (kept.length - from + 1));
        const there = kept.slice(from, to).filter((value) => !Number.isNaN(value));
        const found = { low: 0, high: 0 };
        pyramid.extent(from, to, found);
        expect(found).toEqual(
          there.length ? { low: Math.min(...there), high: Math.max(...there) } : { low: NaN, high: NaN },
        );
      }
    }
  });
});

describe("a history", () => {
  it("keeps the newest rows, and its memory as it was", () => {
    const history = new History(["a"], 100);
    const buffer = history.column("a")!.values.buffer;
    for (let k = 0; k < 1000; k += 1) history.append({ time: [k / 250], columns: [[k]] });
    expect(history.length).toBe(100);
    expect([history.oldest, history.newest]).toEqual([900 / 250, 999 / 250]);
    expect(history.column("a")!.values.buffer).toBe(buffer);
    expect(history.column("a")!.at(history.rowAt(950 / 250))).toBe(950);
    expect(history.nearest(-1)).toBe(900);
    expect(history.time(history.nearest(9.0))).toBe(999 / 250);
  });
  it("passes over what is not newer, and begins anew where a drone was started again", () => {
    const history = new History(["a"], 100);
    history.append({ time: [10, 11, 11, 10.9, 12], columns: [[1, 2, 3, 4, 5]] });
    expect([history.length, history.restarts]).toEqual([3, 0]);
    history.append({ time: [0, 0.1], columns: [[6, 7]] });
    expect([history.length, history.restarts, history.oldest]).toEqual([2, 1, 0]);
  });
  it("tells its listeners until they leave", () => {
    const history = new History(["a"], 10);
    let told = 0;
    const leave = history.listen(() => (told += 1));
    history.append({ time: [1], columns: [[1]] });
    leave();
    history.append({ time: [2], columns: [[1]] });
    expect(told).toBe(1);
  });
});

describe("a slow signal", () => {
  it("keeps its value in the rows between, and is none before its first", () => {
    const history = new History(["fast", "slow"]);
    history.append({
      time: [0, 1, 2, 3],
      columns: [
        [1, 2, 3, 4],
        [NaN, 7, NaN, NaN],
      ],
    });
    expect([history.held("fast"), history.held("slow"), history.held("slow", 0), history.held("none")]).toEqual([
      4,
      7,
      NaN,
      NaN,
    ]);
  });
});
