import { describe, expect, it } from "vitest";
import { meets, routed, type Box } from "../../src/pages/diagram/canvas/route";

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
