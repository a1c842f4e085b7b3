import { describe, expect, it } from "vitest";
import { routed, type Box } from "../../src/pages/diagram/canvas/route";
import { Router, type Ends } from "../../src/pages/diagram/canvas/router";

const block = (x: number, y: number): Box => ({ x, y, width: 80, height: 40 });
const wire: Ends = { id: "w", from: [0, 0], to: [400, 100], way: "right" };

describe("the bends of wires", () => {
  it("are those of each wire alone among all boxes", () => {
    const boxes = new Map(Array.from({ length: 60 }, (_, i) => [`b${i}`, block(120 * (i % 10), 90 * (i % 7) - 200)]));
    const wires = Array.from({ length: 80 }, (_, i): Ends => {
      const [x, y] = [37 * (i % 30), 53 * (i % 11) - 250];
      return { id: `w${i}`, from: [x, y], to: [x + (i % 3 ? 300 : -300), y + 20 * (i % 9)], way: "right" };
    });
    const router = new Router();
    router.update(boxes, wires);
    expect(router.work(Infinity)).toBe(false);
    for (const { id, from, to } of wires) expect(router.route(id)).toEqual(routed(from, to, [...boxes.values()]));
  });
  it("follow a block that comes into their way, and one that goes out of it", () => {
    const router = new Router();
    const settle = (boxes: [string, Box][]): number => {
      router.update(new Map(boxes), [wire]);
      router.work(Infinity);
      return router.route("w").x!;
    };
    expect(settle([])).toBe(200);
    expect(settle([["b", block(160, 80)]])).toBeGreaterThan(240);
    expect(settle([["b", block(160, 300)]])).toBe(200);
  });
  it("are found over some calls where the time is up, and kept where nothing changed", () => {
    const router = new Router();
    const boxes = new Map([["b", block(160, 80)]]);
    const many = Array.from({ length: 40 }, (_, i): Ends => ({ ...wire, id: `w${i}` }));
    router.update(boxes, many);
    expect(router.work(-1)).toBe(true);
    while (router.work(-1));
    const before = many.map(({ id }) => router.route(id));
    router.update(new Map(boxes), many);
    expect(router.work(-1)).toBe(false);
    many.forEach(({ id }, i) => expect(router.route(id)).toBe(before[i]));
  });
  it("are mirrored between two flipped blocks", () => {
    const bent = (boxes: [string, Box][], one: Ends): number => {
      const router = new Router();
      router.update(new Map(boxes), [one]);
      router.work(Infinity);
      return router.route("w").x!;
    };
    const mirrored: [string, Box] = ["b", { ...block(0, 80), x: -240 }];
    const back: Ends = { id: "w", from: [0, 0], to: [-400, 100], way: "left" };
    expect(bent([mirrored], back)).toBe(-bent([["b", block(160, 80)]], wire));
  });
});
