import type uPlot from "uplot";
import { DASHES, type Series } from "../kinds";
import { firstRow } from "../numbers";
import { samplePath } from "./painter";
import { colour } from "./canvas";

export class Curve {
  readonly last: number;

  constructor(readonly series: Series) {
    this.last = Math.min(series.x.length, series.y.length);
  }

  /** Return the first sample at or after `x`. */
  rowAt(x: number): number {
    return firstRow(0, this.last, (row) => !(this.series.x[row]! < x));
  }

  /** Interpolate y at `x`; NaN outside. */
  at(x: number): number {
    const { x: xs, y: ys } = this.series;
    const row = this.rowAt(x);
    if (row >= this.last || (row === 0 && xs[0] !== x)) return NaN;
    if (xs[row] === x) return ys[row]!;
    const share = (x - xs[row - 1]!) / (xs[row]! - xs[row - 1]!);
    return ys[row - 1]! + share * (ys[row]! - ys[row - 1]!);
  }
}

/** Return the least and greatest x of the curves; 0 to 1 if there is none. */
export function xRange(curves: readonly Curve[], log: boolean): [number, number] {
  let [low, high] = [Infinity, -Infinity];
  for (const { series, last } of curves) {
    if (!last) continue;
    const first = log ? (series.x.find((x) => x > 0) ?? Infinity) : series.x[0]!;
    low = Math.min(low, first);
    high = Math.max(high, series.x[last - 1]!);
  }
  return low < high ? [low, high] : log ? [0.1, 10] : Number.isFinite(low) ? [low - 0.5, low + 0.5] : [0, 1];
}

/** Return the least and greatest y of curves and bands from `low` to `high`; NaN if there is no value. */
export function yExtent(curves: readonly Curve[], low: number, high: number): [number, number] {
  let [least, greatest] = [NaN, NaN];
  for (const curve of curves) {
    const { y, band } = curve.series;
    const to = Math.min(curve.last, curve.rowAt(high) + 1);
    for (const values of band === undefined ? [y] : [y, band.low, band.high]) {
      for (let row = curve.rowAt(low); row < to; row += 1) {
        const value = values[row]!;
        if (value !== value) continue;
        if (!(least <= value)) least = value;
        if (!(greatest >= value)) greatest = value;
      }
    }
  }
  return [least, greatest];
}

/** Draw a curve and its band into uPlot's axes. */
export function paintCurve(u: uPlot, curve: Curve): void {
  const { ctx } = u;
  const { x, y, band, kind, dash, faint, colour: token = kind } = curve.series;
  const { min = 0, max = 1 } = u.scales["x"] ?? {};
  const from = Math.max(0, curve.rowAt(min!) - 1);
  const to = Math.min(curve.last, curve.rowAt(max!) + 1);
  const toX = (row: number): number => u.valToPos(x[row]!, "x", true);
  const toY = (value: number): number => u.valToPos(value, "y", true);
  if (band) {
    ctx.fillStyle = colour(token);
    ctx.globalAlpha = 0.18;
    ctx.beginPath();
    for (let row = from; row < to; row += 1) ctx.lineTo(toX(row), toY(band.high[row]!));
    for (let row = to - 1; row >= from; row -= 1) ctx.lineTo(toX(row), toY(band.low[row]!));
    ctx.fill();
    ctx.globalAlpha = 1;
  }
  ctx.strokeStyle = colour(token);
  ctx.lineWidth = devicePixelRatio * (kind === "measured" || faint ? 1 : 1.5);
  if (faint) ctx.globalAlpha = 0.4;
  ctx.setLineDash((dash ?? DASHES[kind] ?? []).map((one) => one * devicePixelRatio));
  ctx.stroke(samplePath(from, to, toX, (row) => toY(y[row]!)));
  ctx.setLineDash([]);
  ctx.globalAlpha = 1;
}
