import type uPlot from "uplot";
import type { History } from "../history";
import { DASHES, type Channel } from "../kinds";
import { bucketPath, columnsOf, room, samplePath, type Columns } from "./painter";
import { colour } from "./palette";
import type { Extent } from "./pyramid";

/** More samples than this on a pixel, and each pixel shows their least and greatest instead. */
const CROWDED = 2;
const extent: Extent = { low: 0, high: 0 };

/** Draws the channels of a history into uPlot's axes. */
export class StripPainter {
  private readonly columns: Columns = room();

  /** Least and greatest of all channels in a part of the time, in the units of the screen; NaN where nothing is. */
  extent(history: History, channels: readonly Channel[], low: number, high: number): [number, number] {
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

  paint(u: uPlot, history: History, channels: readonly Channel[]): void {
    const { bbox, ctx } = u;
    const { min = 0, max = 1 } = u.scales["y"] ?? {};
    const { min: x0 = 0, max: x1 = 1 } = u.scales["x"] ?? {};
    const perX = bbox.width / (x1! - x0!);
    columnsOf(u, (x) => history.rowAt(x), this.columns);
    const from = Math.max(history.first, history.rowAt(x0!) - 1);
    const to = Math.min(history.last, history.rowAt(x1!) + 1);
    const crowded = to - from > CROWDED * this.columns.count;
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
          ? bucketPath(this.columns, column, (value) => zero + perY * value)
          : samplePath(
              from,
              to,
              (row) => bbox.left + (history.time(row) - x0!) * perX,
              (row) => zero + perY * column.at(row),
            ),
      );
    }
    ctx.setLineDash([]);
  }
}
