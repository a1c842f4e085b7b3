import type uPlot from "uplot";
import type { Marker } from "../kinds";
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

/** As `paintMarks`, each with its label; one that would stand on its neighbour's is left out. */
export function paintLabels(u: uPlot, markers: readonly Marker[]): void {
  paintMarks(
    u,
    markers.map((one) => one.x),
  );
  const { ctx, bbox } = u;
  ctx.fillStyle = colour("soft");
  ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
  ctx.textAlign = "left";
  ctx.textBaseline = "bottom";
  let free = -Infinity;
  for (const { x, label } of [...markers].sort((a, b) => a.x - b.x)) {
    const left = u.valToPos(x, "x", true) + 4 * devicePixelRatio;
    if (left < free) continue;
    ctx.fillText(label, left, bbox.top + bbox.height - 3 * devicePixelRatio);
    free = left + ctx.measureText(label).width + 4 * devicePixelRatio;
  }
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
