import type uPlot from "uplot";
import type { Curve } from "./curve";
import { DASHES } from "../kinds";
import { bucketPath, columnsOf, room, samplePath } from "./painter";
import { colour } from "./palette";
import type { Extent } from "./pyramid";

const CROWDED = 4;
const columns = room();
const extent: Extent = { low: 0, high: 0 };

/** Draws a curve and its band into uPlot's axes. */
export function paintCurve(u: uPlot, curve: Curve): void {
  const { ctx } = u;
  const { series } = curve;
  const { min = 0, max = 1 } = u.scales["x"] ?? {};
  const from = Math.max(0, curve.rowAt(min!) - 1);
  const to = Math.min(curve.last, curve.rowAt(max!) + 1);
  const toX = (row: number): number => u.valToPos(series.x[row]!, "x", true);
  const toY = (value: number): number => u.valToPos(value, "y", true);
  if (series.band) {
    // A band is smooth: of a crowded one each so-many-th sample draws the same.
    const stride = Math.max(1, Math.floor((to - from) / (2 * u.bbox.width)));
    ctx.fillStyle = colour(series.colour ?? series.kind);
    ctx.globalAlpha = 0.18;
    ctx.beginPath();
    for (let row = from; row < to; row += stride) ctx.lineTo(toX(row), toY(series.band.high[row]!));
    for (let row = from + Math.floor((to - 1 - from) / stride) * stride; row >= from; row -= stride)
      ctx.lineTo(toX(row), toY(series.band.low[row]!));
    ctx.fill();
    ctx.globalAlpha = 1;
  }
  ctx.strokeStyle = colour(series.colour ?? series.kind);
  ctx.lineWidth = devicePixelRatio * (series.kind === "measured" ? 1 : 1.5);
  ctx.setLineDash((series.dash ?? DASHES[series.kind] ?? []).map((one) => one * devicePixelRatio));
  if (to - from > (CROWDED * u.bbox.width) / devicePixelRatio) {
    columnsOf(u, (x) => curve.rowAt(x), columns, u.scales["x"]?.distr !== 3);
    ctx.stroke(bucketPath(columns, curve.y, toY));
  } else {
    ctx.stroke(samplePath(from, to, toX, (row) => toY(series.y[row]!)));
  }
  ctx.setLineDash([]);
}

/** Least and greatest y of curves and bands from `low` to `high`; NaN where nothing is. */
export function yExtent(curves: readonly Curve[], low: number, high: number): [number, number] {
  let least = NaN;
  let greatest = NaN;
  for (const curve of curves) {
    const from = curve.rowAt(low);
    const to = Math.min(curve.last, curve.rowAt(high) + 1);
    for (const pyramid of [curve.y, curve.low, curve.high]) {
      if (pyramid === undefined) continue;
      pyramid.extent(from, to, extent);
      if (!(least <= extent.low) && extent.low === extent.low) least = extent.low;
      if (!(greatest >= extent.high) && extent.high === extent.high) greatest = extent.high;
    }
  }
  return [least, greatest];
}
