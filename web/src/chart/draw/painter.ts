import type uPlot from "uplot";
import { CURSORS } from "../views.svelte";
import type { History } from "../history";
import { DASHES, type Channel } from "../kinds";
import { colour } from "./canvas";
import type { Extent, Pyramid } from "./pyramid";

/** Rows of each pixel column. */
interface Columns {
  count: number;
  /** Canvas x of pixel column k. */
  place: Float64Array;
  /** Rows edge[k] to edge[k + 1] - 1 fall on it. */
  edge: Float64Array;
}

/** Room for the widest plot: 4 k at two device pixels a pixel, and one. */
const WIDEST = 8193;

function room(): Columns {
  return { count: 0, place: new Float64Array(WIDEST), edge: new Float64Array(WIDEST) };
}

/** Find the rows of each pixel column. Columns stand on multiples of their width, so a moving curve does not flicker. */
function columnsOf(u: uPlot, rowAt: (x: number) => number, into: Columns): void {
  const { left, width } = u.bbox;
  const { min = 0, max = 1 } = u.scales["x"] ?? {};
  const count = Math.min(WIDEST - 1, Math.max(1, Math.round(width / devicePixelRatio)) + 1);
  const step = (max! - min!) / (count - 1);
  const start = Math.floor(min! / step) * step;
  for (let k = 0; k <= count; k += 1) {
    const x = start + k * step;
    into.edge[k] = rowAt(x);
    if (k < count) into.place[k] = left + ((x + step / 2 - min!) / (max! - min!)) * width;
  }
  into.count = count;
}

const extent: Extent = { low: 0, high: 0 };

/** Rows further apart [s] were not received: no line joins them. */
const APART = 1;
type Apart = (row: number) => boolean;

/** Return the path from minimum to maximum of each pixel column, with gaps at NaN and at rows `apart`. */
function bucketPath(columns: Columns, column: Pyramid, toY: (value: number) => number, apart: Apart): Path2D {
  const path = new Path2D();
  let drawing = false;
  let before = NaN;
  for (let k = 0; k < columns.count; k += 1) {
    const from = columns.edge[k]!;
    const to = columns.edge[k + 1]!;
    if (from >= to) continue;
    column.extent(from, to, extent);
    if (apart(from)) drawing = false;
    if (extent.low !== extent.low) {
      drawing = false;
      continue;
    }
    const x = columns.place[k]!;
    const low = toY(extent.low);
    const high = toY(extent.high);
    const lowFirst = drawing ? Math.abs(low - before) < Math.abs(high - before) : true;
    const [one, two] = lowFirst ? [low, high] : [high, low];
    if (drawing) path.lineTo(x, one);
    else path.moveTo(x, one);
    if (one !== two || !drawing) path.lineTo(x, two);
    before = two;
    drawing = true;
  }
  return path;
}

/** Return the path through samples, with gaps at NaN and before rows that are `apart` from the last one. */
export function samplePath(
  from: number,
  to: number,
  toX: (row: number) => number,
  toY: (row: number) => number,
  apart: Apart = () => false,
): Path2D {
  const path = new Path2D();
  let drawing = false;
  for (let row = from; row < to; row += 1) {
    const y = toY(row);
    if (y !== y) {
      drawing = false;
      continue;
    }
    if (drawing && !apart(row)) path.lineTo(toX(row), y);
    else path.moveTo(toX(row), y);
    drawing = true;
  }
  return path;
}

/** Above this number of samples per pixel, each pixel shows minimum and maximum. */
const CROWDED = 2;

/** Painter of channels into uPlot's axes. */
export class StripPainter {
  private readonly columns: Columns = room();

  paint(u: uPlot, history: History, channels: readonly Channel[]): void {
    const { bbox, ctx } = u;
    const { min = 0, max = 1 } = u.scales["y"] ?? {};
    const { min: x0 = 0, max: x1 = 1 } = u.scales["x"] ?? {};
    const perX = bbox.width / (x1! - x0!);
    columnsOf(u, (x) => history.rowAt(x), this.columns);
    const from = Math.max(history.first, history.rowAt(x0!) - 1);
    const to = Math.min(history.last, history.rowAt(x1!) + 1);
    const crowded = to - from > CROWDED * this.columns.count;
    const apart = (row: number) => row > history.first && history.time(row) - history.time(row - 1) > APART;
    for (const channel of channels) {
      const column = history.column(channel.column);
      if (column === undefined) continue;
      const perY = (-bbox.height / (max! - min!)) * (channel.factor ?? 1);
      const zero = bbox.top + (bbox.height * max!) / (max! - min!);
      ctx.strokeStyle = colour(channel.colour ?? channel.kind);
      ctx.lineWidth = devicePixelRatio * (channel.kind === "measured" ? 1 : 1.5);
      ctx.setLineDash((DASHES[channel.kind] ?? []).map((one) => one * devicePixelRatio));
      ctx.stroke(
        crowded
          ? bucketPath(this.columns, column, (value) => zero + perY * value, apart)
          : samplePath(
              from,
              to,
              (row) => bbox.left + (history.time(row) - x0!) * perX,
              (row) => zero + perY * column.at(row),
              apart,
            ),
      );
    }
    ctx.setLineDash([]);
  }
}

/** Return the least and greatest value of channels from `low` to `high`, in units of the screen; NaN without values. */
export function channelExtent(
  history: History,
  channels: readonly Channel[],
  low: number,
  high: number,
): [number, number] {
  const from = history.rowAt(low);
  const to = Math.min(history.last, history.rowAt(high) + 1);
  let least = NaN;
  let greatest = NaN;
  for (const { column, factor = 1 } of channels) {
    history.column(column)?.extent(from, to, extent);
    if (extent.low !== extent.low || history.column(column) === undefined) continue;
    const [one, two] = factor < 0 ? [extent.high, extent.low] : [extent.low, extent.high];
    if (!(least <= one * factor)) least = one * factor;
    if (!(greatest >= two * factor)) greatest = two * factor;
  }
  return [least, greatest];
}

/** Add the vertical line at `mark` to the path; returns its place on the canvas. */
function vertical(u: uPlot, mark: number): number {
  const x = Math.round(u.valToPos(mark, "x", true)) + 0.5;
  u.ctx.moveTo(x, u.bbox.top);
  u.ctx.lineTo(x, u.bbox.top + u.bbox.height);
  return x;
}

export function paintMarks(u: uPlot, marks: readonly number[]): void {
  const { ctx } = u;
  ctx.strokeStyle = colour("soft");
  ctx.globalAlpha = 0.6;
  ctx.lineWidth = devicePixelRatio;
  ctx.setLineDash([2 * devicePixelRatio, 3 * devicePixelRatio]);
  ctx.beginPath();
  for (const mark of marks) vertical(u, mark);
  ctx.stroke();
  ctx.setLineDash([]);
  ctx.globalAlpha = 1;
}

export function paintPins(u: uPlot, pins: readonly number[]): void {
  const { ctx, bbox } = u;
  const ratio = devicePixelRatio;
  ctx.strokeStyle = ctx.fillStyle = colour("accent");
  ctx.lineWidth = ratio;
  ctx.font = `600 ${11 * ratio}px system-ui, sans-serif`;
  ctx.textAlign = "left";
  ctx.textBaseline = "top";
  pins.forEach((pin, k) => {
    ctx.beginPath();
    const x = vertical(u, pin);
    ctx.stroke();
    ctx.fillText(CURSORS[k] ?? "", x + 4 * ratio, bbox.top + 3 * ratio);
  });
}
