import { describe, expect, it } from "vitest";
import { meets, routed, Router, type Box, type Ends } from "../../src/pages/diagram/canvas/route";

const block = (x: number, y: number): Box => ({ x, y, width: 80, height: 40 });

describe("a wire", () => {
  it("bends in the middle where nothing stands in its way", () => {
    expect(routed([0, 0], [200, 60], [])).toEqual({ x: 100 });
  });
  it("goes around a block in the middle of its way", () => {
    const boxes = [block(160, 80)];
    const { x } = routed([0, 0], [400, 100], [block(160, -20)]);
    expect(x).toBeLessThan(160);
    const other = routed([0, 0], [400, 100], boxes).x!;
    expect(other).toBeGreaterThan(240);
    expect(
      meets(
        [
          [0, 0],
          [other, 0],
          [other, 100],
          [400, 100],
        ],
        boxes,
      ),
    ).toBe(0);
  });
  it("that goes back runs neither through its own blocks nor through others, nor through their names", () => {
    const boxes = [block(0, 0), block(120, 0), block(240, 0)];
    const { y } = routed([320, 20], [0, 20], boxes);
    expect(y! < 0 || y! > 56).toBe(true);
  });
  it("takes the way with the fewest blocks where none is free", () => {
    const boxes = [block(100, -20), block(200, -20), block(300, 80)];
    const { x } = routed([0, 0], [500, 100], boxes);
    expect(x).toBeLessThan(100);
  });
});

describe("the router of a sheet", () => {
  const wire: Ends = { id: "w", from: [0, 0], to: [400, 100], way: "right" };
  const update = (router: Router, boxes: [string, Box][], wires = [wire], milliseconds = 1000): boolean =>
    router.update(new Map(boxes), wires, milliseconds);

  it("routes each wire again when a block comes into its way or leaves it", () => {
    const router = new Router();
    const bend = (boxes: [string, Box][]): number => (update(router, boxes), router.route("w").x!);
    expect(bend([])).toBe(200);
    expect(bend([["b", block(160, 80)]])).toBeGreaterThan(240);
    expect(bend([["b", block(160, 300)]])).toBe(200);
  });
  it("leaves wires for the next call when the time is up, and keeps the others", () => {
    const router = new Router();
    const boxes: [string, Box][] = [["b", block(160, 80)]];
    expect(update(router, boxes, [wire], -1)).toBe(true);
    expect(update(router, boxes)).toBe(false);
    const before = router.route("w");
    expect(update(router, boxes, [wire], -1)).toBe(false);
    expect(router.route("w")).toBe(before);
  });
  it("mirrors a wire between two flipped blocks", () => {
    const [left, right] = [new Router(), new Router()];
    update(left, [["b", { ...block(0, 80), x: -240 }]], [{ ...wire, to: [-400, 100], way: "left" }]);
    update(right, [["b", block(160, 80)]]);
    expect(left.route("w").x).toBe(-right.route("w").x!);
  });
});
