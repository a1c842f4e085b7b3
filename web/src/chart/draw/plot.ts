import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { askFrame, colour, forgetFrame, onTheme } from "./canvas";
import { tick } from "../numbers";
import { TimeView, type View } from "../views.svelte";

const FONT = '12px system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", "Liberation Sans", sans-serif';
/** Pixels between ticks; a low plot has three ticks too. */
const TICKS_Y = (height: number): number => Math.max(14, Math.min(26, height / 3.5));

/** Axes, grid and pointer of uPlot around curves that a painter draws. */
export interface Plot {
  u: uPlot;
  /** Draw in the next frame. */
  ask: () => void;
  end: () => void;
}

/**
 * Make a plot of a view. `paint` draws the curves, which uPlot would copy at each frame; `axis` returns the range of the
 * y axis for a range of x.
 */
export function makePlot(
  target: HTMLElement,
  view: View,
  labels: () => readonly [x: string, y: string],
  axis: (low: number, high: number) => readonly [number, number],
  paint: (u: uPlot) => void,
  onPointer: (x: number | null) => void,
): Plot {
  const style: uPlot.Axis = {
    stroke: () => colour("soft"),
    grid: { stroke: () => colour("rule"), width: 1 },
    ticks: { stroke: () => colour("rule"), width: 1, size: 4 },
    font: FONT,
    labelFont: FONT,
    labelGap: 2,
    labelSize: 18,
    values: (_u, ticks) => ticks.map(tick),
  };
  const fromOrigin: uPlot.Axis = view.log
    ? {}
    : {
        splits: (_u, _axis, low, high, step) => {
          const first = Math.ceil((low - view.origin()) / step);
          const last = Math.floor((high - view.origin()) / step);
          return Array.from({ length: last - first + 1 }, (_, k) => (first + k) * step + view.origin());
        },
        values: (_u, ticks) => ticks.map((one) => tick(one - view.origin())),
      };
  const draw = (u: uPlot): void => {
    const { ctx, bbox } = u;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.lineJoin = "round";
    paint(u);
    ctx.restore();
  };
  const u = new uPlot(
    {
      width: Math.max(1, target.clientWidth),
      height: Math.max(1, target.clientHeight),
      legend: { show: false },
      padding: [6, 10, 0, 0],
      cursor: {
        drag: { x: false, y: false },
        points: { show: false },
        y: false,
        ...(view instanceof TimeView ? { sync: { key: view.key, scales: ["x", null] } } : {}),
      },
      scales: { x: { time: false, auto: false, distr: view.log ? 3 : 1 }, y: { auto: false } },
      series: [{}],
      axes: [
        { ...style, ...fromOrigin, ...(labels()[0] ? { label: () => labels()[0] } : {}), size: 28, space: 64 },
        { ...style, label: () => labels()[1], size: 50, space: (_u, _axis, _low, _high, height) => TICKS_Y(height) },
      ],
      hooks: {
        draw: [draw],
        setCursor: [(self) => onPointer((self.cursor.left ?? -1) < 0 ? null : self.posToVal(self.cursor.left!, "x"))],
      },
    },
    [[]],
    target,
  );
  const scale = (): void => {
    const [low, high] = view.range();
    const [bottom, top] = axis(low, high);
    u.batch(() => {
      u.setScale("x", { min: low, max: high });
      u.setScale("y", { min: bottom, max: top });
    });
  };
  const ask = (): void => askFrame(scale);
  const endTheme = onTheme(ask);
  const sizes = new ResizeObserver(() => {
    const { clientWidth: width, clientHeight: height } = target;
    if (width === 0 || height === 0 || (width === u.width && height === u.height)) return;
    u.setSize({ width, height });
    ask();
  });
  sizes.observe(target);
  const end = (): void => {
    endTheme();
    forgetFrame(scale);
    sizes.disconnect();
    u.destroy();
  };
  return { u, ask, end };
}

/** Return an axis range with some margin, never narrower than `least`. */
export function roomy(low: number, high: number, least: number): [number, number] {
  if (!(low <= high)) return [-least / 2, least / 2];
  // Ticks that are closer than floats can tell apart make uPlot count without end.
  const narrowest = Math.max(least, 1e-6 * Math.abs(low), 1e-6 * Math.abs(high));
  const spare = Math.max(0.08 * (high - low), (narrowest - (high - low)) / 2);
  return [low - spare, high + spare];
}

/** Keep the range while the values fill it well; else as `roomy`. */
export function steady(
  before: readonly [number, number] | undefined,
  low: number,
  high: number,
  least: number,
): [number, number] {
  const fresh = roomy(low, high, least);
  if (before === undefined || !(low <= high)) return fresh;
  const fits = low >= before[0] && high <= before[1];
  const filled = (fresh[1] - fresh[0]) / (before[1] - before[0]);
  return fits && filled > 0.6 ? [before[0], before[1]] : fresh;
}
