import type { History } from "./history";
import type { Channel, Series } from "./kinds";
import { colour } from "./draw/palette";

/** One name that CSV readers keep as it is. */
function quoted(text: string): string {
  return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

function number(value: number): string {
  return Number.isFinite(value) ? String(value) : "";
}

/** Each row from `low` to `high` [s] of a history as CSV, at its full rate, in the units of the screen. */
export function historyCsv(history: History, channels: readonly Channel[], low: number, high: number): string {
  const lines = [["time [s]", ...channels.map((one) => `${one.label} [${one.unit}]`)].map(quoted).join(",")];
  const columns = channels.map((one) => history.column(one.column));
  for (let row = history.rowAt(low); row < history.last && history.time(row) <= high; row += 1) {
    const values = columns.map((column, c) => number((column?.at(row) ?? NaN) * (channels[c]!.factor ?? 1)));
    lines.push([String(history.time(row)), ...values].join(","));
  }
  return lines.join("\n") + "\n";
}

/** The curves of a static plot as CSV, one behind the other, since each has an x of its own. */
export function seriesCsv(
  series: readonly Series[],
  xLabel: string,
  yLabel: string,
  low: number,
  high: number,
): string {
  const lines = [["curve", xLabel, yLabel].map(quoted).join(",")];
  for (const { label, x, y } of series) {
    x.forEach((value, k) => {
      if (value >= low && value <= high) lines.push(`${quoted(label)},${number(value)},${number(y[k]!)}`);
    });
  }
  return lines.join("\n") + "\n";
}

/** Plots under each other with their titles, as they are on the screen. */
export async function plotsPng(plots: readonly { title: string; canvas: HTMLCanvasElement }[]): Promise<Blob> {
  const ratio = devicePixelRatio;
  const head = 24 * ratio;
  const sheet = document.createElement("canvas");
  sheet.width = Math.max(1, ...plots.map((one) => one.canvas.width));
  sheet.height = plots.reduce((sum, one) => sum + one.canvas.height + head, 0);
  const ctx = sheet.getContext("2d");
  if (ctx === null) throw new Error("this browser cannot draw the picture: export CSV instead");
  ctx.fillStyle = colour("card");
  ctx.fillRect(0, 0, sheet.width, sheet.height);
  ctx.font = `600 ${13 * ratio}px system-ui, sans-serif`;
  ctx.textBaseline = "middle";
  let top = 0;
  for (const { title, canvas } of plots) {
    ctx.fillStyle = colour("ink");
    ctx.fillText(title, 8 * ratio, top + head / 2);
    ctx.drawImage(canvas, 0, top + head);
    top += head + canvas.height;
  }
  const blob = await new Promise<Blob | null>((done) => sheet.toBlob(done, "image/png"));
  if (blob === null) throw new Error("this browser cannot write the picture: make the window smaller, or export CSV");
  return blob;
}

/** Hands a file to the user. */
export function download(name: string, content: Blob | string, kind = "text/csv"): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content instanceof Blob ? content : new Blob([content], { type: kind }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
