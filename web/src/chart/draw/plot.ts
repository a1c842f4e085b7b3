import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { askFrame, colour, forgetFrame, onTheme } from "./canvas";
import { tick } from "../numbers";

const FONT = '12px system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", "Liberation Sans", sans-serif';
const Y_AXIS = 70;
/** Pixels between ticks; a low plot has three ticks too. */
const TICKS_Y = (height: number): number => Math.max(14, Math.min(26, height / 3.5));

export interface PlotOptions {
  labels: () => readonly [x: string, y: string];
  xLog?: boolean;
  key?: string;
}

/** Visible ranges. */
export interface Seen {
  x: readonly [number, number];
  y: readonly [number, number];
}

/**
 * Axes, grid and pointer of uPlot around curves that `paint` draws: uPlot would copy each curve at each frame.
 *
 * `seen` is asked at each frame for what is shown; `ask` asks for a frame.
 */
export class Plot {
  readonly u: uPlot;
  readonly ask: () => void;
  private readonly forget: () => void;
  private readonly sizes: ResizeObserver;

  constructor(
    target: HTMLElement,
    options: PlotOptions,
    seen: (u: uPlot) => Seen,
    paint: (u: uPlot) => void,
    onPointer: (x: number | null) => void,
  ) {
    const axis: uPlot.Axis = {
      stroke: () => colour("soft"),
      grid: { stroke: () => colour("rule"), width: 1 },
      ticks: { stroke: () => colour("rule"), width: 1, size: 4 },
      font: FONT,
      labelFont: FONT,
      labelGap: 2,
      labelSize: 18,
      values: (_u, ticks) => ticks.map(tick),
    };
    const cursor: uPlot.Cursor = {
      drag: { x: false, y: false },
      points: { show: false },
      y: false,
      ...(options.key === undefined ? {} : { sync: { key: options.key, scales: ["x", null] } }),
    };
    this.u = new uPlot(
      {
        width: Math.max(1, target.clientWidth),
        height: Math.max(1, target.clientHeight),
        legend: { show: false },
        padding: [6, 10, 0, 0],
        cursor,
        scales: {
          x: { time: false, auto: false, distr: options.xLog ? 3 : 1 },
          y: { auto: false },
        },
        series: [{}],
        axes: [
          { ...axis, ...(options.labels()[0] ? { label: () => options.labels()[0] } : {}), size: 28, space: 64 },
          {
            ...axis,
            label: () => options.labels()[1],
            size: Y_AXIS - 20,
            space: (_u, _axis, _low, _high, height) => TICKS_Y(height),
          },
        ],
        hooks: {
          draw: [
            (u) => {
              const { ctx, bbox } = u;
              ctx.save();
              ctx.beginPath();
              ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
              ctx.clip();
              ctx.lineJoin = "round";
              paint(u);
              ctx.restore();
            },
          ],
          setCursor: [(u) => onPointer((u.cursor.left ?? -1) < 0 ? null : u.posToVal(u.cursor.left!, "x"))],
        },
      },
      [[]],
      target,
    );
    const draw = (): void => {
      const { x, y } = seen(this.u);
      this.u.batch(() => {
        this.u.setScale("x", { min: x[0], max: x[1] });
        this.u.setScale("y", { min: y[0], max: y[1] });
      });
    };
    this.ask = () => askFrame(draw);
    this.forget = () => forgetFrame(draw);
    const endTheme = onTheme(this.ask);
    this.sizes = new ResizeObserver(() => {
      const width = target.clientWidth;
      const height = target.clientHeight;
      if (width > 0 && height > 0 && (width !== this.u.width || height !== this.u.height)) {
        this.u.setSize({ width, height });
        this.ask();
      }
    });
    this.sizes.observe(target);
    this.end = () => {
      endTheme();
      this.forget();
      this.sizes.disconnect();
      this.u.destroy();
    };
  }

  readonly end: () => void;
}

/** Return an axis range with some margin, never narrower than `least`. */
export function roomy(low: number, high: number, least: number): [number, number] {
  if (!(low <= high)) return [-least / 2, least / 2];
  const spare = Math.max(0.08 * (high - low), (least - (high - low)) / 2);
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
