import { messageOf } from "../api/client";
import type { History } from "./history";
import { DASHES, type Channel, type Series, type Stroke } from "./kinds";
import { colour } from "./draw/canvas";

function quoted(text: string): string {
  return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

function number(value: number): string {
  return Number.isFinite(value) ? String(value) : "";
}

/** Format a float32 value. */
function single(value: number): string {
  return Number.isFinite(value) ? String(Number(value.toPrecision(7))) : "";
}

/**
 * Each row from `low` to `high` [s] of a history as CSV, at its full rate, in the units of the screen. Columns have the
 * names of signals.TOPICS: each is there once. What comes less often than the rows is empty in some.
 */
export function historyCsv(history: History, channels: readonly Channel[], low: number, high: number): string {
  const lines = [
    ["time [s]", ...channels.map(({ column, unit }) => (unit ? `${column} [${unit}]` : column))].map(quoted).join(","),
  ];
  const columns = channels.map((one) => history.column(one.column));
  for (let row = history.rowAt(low); row < history.last && history.time(row) <= high; row += 1) {
    const values = columns.map((column, c) => single((column?.at(row) ?? NaN) * (channels[c]!.factor ?? 1)));
    lines.push([String(Number(history.time(row).toFixed(6))), ...values].join(","));
  }
  return lines.join("\n") + "\n";
}

/** Return the curves of a static plot as CSV, one after the other. */
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

/** Plot in an exported picture. */
export interface Pictured {
  title: string;
  lines: readonly Stroke[];
  canvas: HTMLCanvasElement;
}

async function plotsPng(plots: readonly Pictured[]): Promise<Blob> {
  const ratio = devicePixelRatio;
  const row = 24 * ratio;
  const gap = 14 * ratio;
  const sample = 22 * ratio;
  const sheet = document.createElement("canvas");
  sheet.width = Math.max(1, ...plots.map((one) => one.canvas.width));
  const ctx = sheet.getContext("2d");
  if (ctx === null) throw new Error("this browser cannot draw the picture: export CSV instead");
  const bold = `600 ${13 * ratio}px system-ui, sans-serif`;
  const plain = `${12 * ratio}px system-ui, sans-serif`;
  const width = (text: string, font: string): number => {
    ctx.font = font;
    return ctx.measureText(text).width;
  };
  // Where each part of a legend stands, below the one before where the line is full.
  const heads = plots.map(({ title, lines }) => {
    let [x, y] = [8 * ratio + width(title, bold) + gap, 0];
    const places = lines.map((line) => {
      const needed = sample + 5 * ratio + width(line.label, plain);
      if (x + needed > sheet.width && x > 8 * ratio) [x, y] = [8 * ratio, y + row];
      const place = { ...line, x, y };
      x += needed + gap;
      return place;
    });
    return { places, height: y + row };
  });
  sheet.height = plots.reduce((sum, one, k) => sum + one.canvas.height + heads[k]!.height, 0);
  ctx.fillStyle = colour("card");
  ctx.fillRect(0, 0, sheet.width, sheet.height);
  ctx.textBaseline = "middle";
  let top = 0;
  plots.forEach(({ title, canvas }, k) => {
    const { places, height } = heads[k]!;
    ctx.fillStyle = colour("ink");
    ctx.font = bold;
    ctx.fillText(title, 8 * ratio, top + row / 2);
    ctx.font = plain;
    for (const { label, kind, colour: token, dash, x, y } of places) {
      const middle = top + y + row / 2;
      ctx.strokeStyle = colour(token ?? kind);
      ctx.lineWidth = 2.5 * ratio;
      ctx.setLineDash((dash ?? DASHES[kind] ?? []).map((one) => one * ratio));
      ctx.beginPath();
      ctx.moveTo(x, middle);
      ctx.lineTo(x + sample, middle);
      ctx.stroke();
      ctx.fillText(label, x + sample + 5 * ratio, middle);
    }
    ctx.drawImage(canvas, 0, top + height);
    top += height + canvas.height;
  });
  const blob = await new Promise<Blob | null>((done) => sheet.toBlob(done, "image/png"));
  if (blob === null) throw new Error("this browser cannot write the picture: make the window smaller, or export CSV");
  return blob;
}

/** Save plots as `file`.png. Returns "" or why it failed. */
export async function savePng(file: string, plots: readonly Pictured[]): Promise<string> {
  try {
    download(`${file}.png`, await plotsPng(plots));
    return "";
  } catch (failure) {
    return messageOf(failure);
  }
}

export function download(name: string, content: Blob | string, kind = "text/csv"): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content instanceof Blob ? content : new Blob([content], { type: kind }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
