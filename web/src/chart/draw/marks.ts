import type uPlot from "uplot";
import { colour } from "./palette";

/** Thin vertical lines where something happened. */
export function paintMarks(u: uPlot, marks: readonly number[]): void {
  const { ctx, bbox } = u;
  ctx.strokeStyle = colour("soft");
  ctx.globalAlpha = 0.6;
  ctx.lineWidth = devicePixelRatio;
  ctx.setLineDash([2 * devicePixelRatio, 3 * devicePixelRatio]);
  ctx.beginPath();
  for (const mark of marks) {
    const x = Math.round(u.valToPos(mark, "x", true)) + 0.5;
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
  }
  ctx.stroke();
  ctx.setLineDash([]);
  ctx.globalAlpha = 1;
}

/** Vertical lines for cursors, with the letters A and B. */
export function paintPins(u: uPlot, pins: readonly number[]): void {
  const { ctx, bbox } = u;
  const ratio = devicePixelRatio;
  ctx.strokeStyle = ctx.fillStyle = colour("accent");
  ctx.lineWidth = ratio;
  ctx.font = `600 ${11 * ratio}px system-ui, sans-serif`;
  ctx.textAlign = "left";
  ctx.textBaseline = "top";
  pins.forEach((pin, k) => {
    const x = Math.round(u.valToPos(pin, "x", true)) + 0.5;
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    ctx.fillText("AB"[k] ?? "", x + 4 * ratio, bbox.top + 3 * ratio);
  });
}
