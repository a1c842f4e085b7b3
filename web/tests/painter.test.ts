import { afterAll, describe, expect, it, vi } from "vitest";
import { StripPainter } from "../src/chart/draw/painter";
import { History } from "../src/chart/history";
import type { Channel } from "../src/chart/kinds";

vi.stubGlobal("document", { createElement: () => ({ style: {} }), body: { append: () => {} } });
vi.stubGlobal("matchMedia", () => ({ addEventListener: () => {} }));
vi.stubGlobal(
  "MutationObserver",
  class {
    observe(): void {}
  },
);
vi.stubGlobal("getComputedStyle", () => ({ color: "black" }));
vi.stubGlobal("devicePixelRatio", 1);
vi.stubGlobal(
  "Path2D",
  class {
    begun = 0;
    moveTo(): void {
      this.begun += 1;
    }
    lineTo(): void {}
  },
);

afterAll(() => vi.unstubAllGlobals());

describe("a live curve", () => {
  it.each([
    ["few", 10],
    ["many", 250],
  ])("is broken where rows are missing, with %s rows", (_, rate) => {
    const history = new History(["theta"]);
    const times = [0, 1, 7, 8].flatMap((second) => Array.from({ length: rate }, (_, k) => second + k / rate));
    history.append({ time: times, columns: [times] });
    const lines: number[] = [];
    const ctx = { setLineDash: () => {}, stroke: (path: { begun: number }) => lines.push(path.begun) };
    const bbox = { left: 0, top: 0, width: 300, height: 100 };
    const u = { bbox, ctx, scales: { x: { min: 0, max: 10 }, y: { min: 0, max: 10 } } };
    const channel: Channel = { column: "theta", label: "estimate", kind: "estimate", unit: "" };
    new StripPainter().paint(u as never, history, [channel]);
    expect(lines).toEqual([2]);
  });
});
