// How logs are spoken of: names that the server takes, sizes, times, what flew.

import { tick } from "../../chart/numbers";
import type { LogRow, LogSummary } from "../../api/logs";

const SUFFIX = /\.(mcap|mat|parquet|csv|ulg)$/i;

/** Return a file name that the server accepts. */
export function sentName(name: string): string {
  const suffix = SUFFIX.exec(name)?.[0].toLowerCase() ?? "";
  const stem = name
    .slice(0, name.length - suffix.length)
    .normalize("NFKD")
    .replace(/[^A-Za-z0-9_. +-]+/g, "-")
    .replace(/\.{2,}/g, ".")
    .replace(/^[^A-Za-z0-9]+|\.+$/g, "")
    .slice(0, 100);
  return (stem || "log") + suffix;
}

/** Return why a file cannot be uploaded, or "". */
export function notALog(file: Pick<File, "name" | "size">): string {
  if (!SUFFIX.test(file.name)) return `${file.name} is not a log: .mcap, .mat, .parquet, .csv and .ulg are read.`;
  if (file.size === 0) return `${file.name} is empty.`;
  return file.size > 256 << 20 ? `${file.name} is larger than the 256 MiB that are taken here.` : "";
}

export function size(bytes: number): string {
  return bytes < 1e6 ? `${Math.max(1, Math.round(bytes / 1e3))} kB` : `${(bytes / 1e6).toFixed(1)} MB`;
}

export function duration(seconds: number): string {
  if (seconds < 100) return `${seconds.toFixed(1)} s`;
  const whole = Math.round(seconds);
  return `${Math.floor(whole / 60)} min ${String(whole % 60).padStart(2, "0")} s`;
}

export function when(row: Pick<LogRow, "changed">, summary?: Pick<LogSummary, "began">): string {
  const told = summary?.began ? Date.parse(summary.began) : NaN;
  const date = new Date(Number.isFinite(told) ? told : 1000 * row.changed);
  return date.toLocaleString(undefined, { dateStyle: "medium", timeStyle: "short" });
}

export function flown(summary: LogSummary): string {
  const rig = summary.rig === null ? null : `rig ${summary.rig}${summary.virtual ? " (virtual)" : ""}`;
  const controller = summary.controller === "stock" ? "stock controllers" : summary.controller;
  const tuned = summary.tuned.map(([name, value]) => `${name} ${tick(value)}`);
  const drone = summary.drone === null ? null : `drone ${summary.drone}`;
  return [drone, rig, controller, ...tuned].filter(Boolean).join(", ");
}

/** Return the SVG path of a spark within `width` and `height`. */
export function sparkPath(
  low: readonly (number | null)[],
  high: readonly (number | null)[],
  width: number,
  height: number,
): string {
  const known = [...low, ...high].filter((value): value is number => value !== null);
  if (!known.length) return "";
  const [least, greatest] = [Math.min(...known), Math.max(...known)];
  const y = (value: number): string =>
    (greatest > least ? height * (1 - (value - least) / (greatest - least)) : height / 2).toFixed(1);
  let pen = "";
  const parts = low.map((value, k) => {
    const top = high[k] ?? null;
    pen = value === null || top === null ? "" : pen === "" ? "M" : "L";
    const x = (((k + 0.5) / low.length) * width).toFixed(1);
    return pen && `${pen}${x} ${y(top!)}L${x} ${y(value!)}`;
  });
  return parts.join("");
}
