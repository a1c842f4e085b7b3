// The logs of the server: the list, what each holds, views of it, and what is done with it.

import { get, request, send, upload } from "./client";

export interface LogRow {
  name: string;
  file: string;
  /** "" for the server's own folder; others are read-only. */
  folder: string;
  bytes: number;
  /** Unix time [s]. */
  changed: number;
  notes: boolean;
  recording: boolean;
}

/** Deleted log; it can be restored until `until`, Unix time [s]. */
export interface DeletedLog {
  entry: string;
  name: string;
  until: number;
}

export interface LogList {
  logs: LogRow[];
  trash: DeletedLog[];
  kept_days: number;
}

/** Minimum and maximum per interval; null without samples. */
export interface Spark {
  text: string;
  low: (number | null)[];
  high: (number | null)[];
}

/** Reason why a log cannot be read. */
export interface Unreadable {
  unreadable: string;
}

/** Summary in the list; null if the log does not tell. */
export interface LogSummary {
  span: [number, number];
  duration: number;
  began: string | null;
  experiment: string | null;
  rig: string | null;
  virtual: boolean | null;
  drone: number | null;
  controller: string | null;
  /** Parameters that are not at their defaults at the start. */
  tuned: [string, number][];
  reason: string | null;
  channels: number;
  spark: Spark | null;
}

export interface LogFacts extends LogSummary, LogKept {
  texts: [number, string, string][];
  changes: [number, string, number][];
}

/** Facts that an unreadable log has too. */
export interface LogKept {
  notes: string;
  ours: boolean;
  formats: Format[];
}

/** Curve in base 64, little-endian: float64 times, float32 values. */
export interface PackedCurve {
  label: string;
  held: boolean;
  time: string;
  value: string;
}

export interface Band {
  start: number;
  stop: number;
  label: string;
}

export interface LogView {
  window: [number, number];
  views: { label: string; curves: PackedCurve[] }[];
  modes: Band[];
  failsafe: Band[];
  excitations: Band[];
  notes: string[];
}

/** Figures of one step, SI; null if not reached. */
export interface LoggedStep {
  loop: "rate" | "attitude" | "velocity" | "position";
  time: number;
  before: number;
  after: number;
  peak_moment: number | null;
  rise_time: number | null;
  overshoot: number | null;
  /** Of the mean of `averaged` responses. */
  settling_time: number | null;
  averaged: number;
  peak: number | null;
}

/** Steps of a loop under the same parameters, over each other, as shares of the step; `after_s` is their last change. */
export interface LoggedFold {
  loop: LoggedStep["loop"];
  after_s: number | null;
  /** Figure -> steps that have it, mean, deviation, least and greatest value. */
  statistics: Record<string, (number | null)[]>;
  time: number[];
  shares: number[][];
  mean: number[];
  deviation: number[];
}

export interface LogComparison extends LogView {
  zero: Record<string, number>;
  /** Name of each flight by what differs among them; curves have it. */
  names: Record<string, string>;
  steps: Record<string, LoggedStep[]>;
  /** Why the flights are aligned at their starts and not at steps, or "". */
  unaligned: string;
}

/** Samples from `start` [s] at `rate` [Hz]; float32 columns in base 64. */
export interface LogReplay {
  start: number;
  rate: number;
  count: number;
  columns: Record<string, string>;
}

export type Format = "mcap" | "mat" | "parquet" | "csv" | "ulg";

const FILE_S = 180;
const of = (name: string): string => `logs/${encodeURIComponent(name)}`;

/** Make a new log of the sound parts of a damaged one. */
export const recoverLog = (name: string): Promise<{ name: string; samples: number; what: string[] }> =>
  send("POST", `${of(name)}/recover`);
export const listLogs = (): Promise<LogList> => get("logs");
export const logFacts = (name: string): Promise<LogFacts | (Unreadable & LogKept)> => get(of(name));
export const logSummary = (name: string): Promise<LogSummary | Unreadable> => get(`${of(name)}/summary`);
export const logReplay = (name: string): Promise<LogReplay> => get(`${of(name)}/replay`);
export const logSteps = (name: string): Promise<{ steps: LoggedStep[]; unclear: string }> => get(`${of(name)}/steps`);

export const logSignals = (name: string): Promise<[string, string, string][]> => get(`${of(name)}/signals`);
export const logFold = (name: string): Promise<LoggedFold[]> => get(`${of(name)}/fold`);
export const renameLog = (name: string, to: string): Promise<{ name: string }> =>
  send("POST", `${of(name)}/rename?to=${encodeURIComponent(to)}`);

/** Return a window of a log, or all of it, with `points` per curve: plots of the signals in `panels`, then the usual. */
export function logView(
  name: string,
  window: readonly [number, number] | undefined,
  points: number,
  panels: readonly (readonly string[])[],
): Promise<LogView> {
  const query = new URLSearchParams();
  for (const panel of panels) query.append("panel", panel.join("\n"));
  addPart(query, window, points);
  return get(`${of(name)}/view?${query}`);
}

function addPart(query: URLSearchParams, window: readonly [number, number] | undefined, points: number): void {
  query.set("points", String(points));
  if (!window) return;
  query.set("begin", String(window[0]));
  query.set("end", String(window[1]));
}

/** Compare logs; `zero` are their times 0 [s], in place of their first steps; `window` counts from these. */
export function compareLogs(
  names: readonly string[],
  align: "step" | "start",
  zero: readonly number[],
  window: readonly [number, number] | undefined,
  points: number,
): Promise<LogComparison> {
  const query = new URLSearchParams([["align", align], ...names.map((name) => ["name", name])]);
  for (const time of zero) query.append("zero", String(time));
  addPart(query, window, points);
  return get(`logs/compare?${query}`);
}

/** Download several logs, each in its own format, as one zip file. */
export async function logsZip(names: readonly string[]): Promise<Blob> {
  const query = new URLSearchParams(names.map((name) => ["name", name]));
  return (await request("GET", `logs/zip?${query}`, undefined, 4 * FILE_S)).blob();
}

export async function logFile(name: string, form: Format): Promise<Blob> {
  return (await request("GET", `${of(name)}/file?form=${form}`, undefined, FILE_S)).blob();
}

export async function addLog(
  name: string,
  content: Blob,
  sent: (share: number) => void,
  end: AbortSignal,
): Promise<string> {
  return ((await upload(of(name), content, sent, end)) as { name: string }).name;
}

export const deleteLog = (name: string): Promise<DeletedLog> => send("DELETE", of(name));
export const restoreLog = (entry: string): Promise<{ name: string }> =>
  send("POST", `logs/trash/${encodeURIComponent(entry)}/restore`);
export const writeNotes = (name: string, text: string): Promise<{ text: string }> =>
  send("PUT", `${of(name)}/notes`, { text });
