// The logs of the server: the list, what each holds, views of it, and what is done with it.

import { get, request, send, upload } from "./client";

/** A row of the list. */
export interface LogRow {
  name: string;
  file: string;
  /** "" for the server's own folder; another's logs are only read. */
  folder: string;
  bytes: number;
  /** Of its last change [s, unix]. */
  changed: number;
  notes: boolean;
  recording: boolean;
}

/** A deleted log, which can be brought back until `until` [s, unix]. */
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

/** Lowest and highest values of equal parts of a flight; null where nothing was logged. */
export interface Spark {
  channel: string;
  text: string;
  unit: string;
  low: (number | null)[];
  high: (number | null)[];
}

/** A log that is damaged, being recorded or gone: why nothing is told of it. */
export interface Unreadable {
  unreadable: string;
}

/** What the list says of a log; null for what it does not tell. */
export interface LogSummary {
  span: [number, number];
  duration: number;
  began: string | null;
  experiment: string | null;
  rig: string | null;
  virtual: boolean | null;
  drone: number | null;
  controller: string | null;
  seed: number | null;
  reason: string | null;
  channels: number;
  spark: Spark | null;
}

/** And what an open one shows; times in seconds of the log. */
export interface LogFacts extends LogSummary, LogKept {
  parameters: [string, number][];
  texts: [number, string, string][];
  changes: [number, string, number][];
}

/** What is there of a log that cannot be read, too. */
export interface LogKept {
  notes: string;
  ours: boolean;
  /** In which it can be had as a file. */
  formats: Format[];
}

/** A curve; its numbers are little-endian in base 64: float64 times, float32 values. */
export interface PackedCurve {
  label: string;
  channel: string;
  held: boolean;
  time: string;
  value: string;
}

/** A stretch of time with a name. */
export interface Band {
  start: number;
  stop: number;
  label: string;
}

export interface LogView {
  title: string;
  about: string;
  window: [number, number];
  views: { label: string; curves: PackedCurve[] }[];
  modes: Band[];
  failsafe: Band[];
  excitations: Band[];
  notes: string[];
}

/** The response to one step; SI, null where it was not reached. */
export interface LoggedStep {
  loop: "rate" | "attitude" | "velocity" | "position";
  time: number;
  before: number;
  after: number;
  peak_moment: number | null;
  rise_time: number | null;
  overshoot: number | null;
  settling_time: number | null;
  peak: number | null;
}

export interface LogComparison extends LogView {
  steps: Record<string, LoggedStep[]>;
  zero: Record<string, number>;
}

/** Samples at equal times from `start` [s], `rate` [Hz]; columns of float32 in base 64. */
export interface LogReplay {
  start: number;
  rate: number;
  count: number;
  columns: Record<string, string>;
}

export type Format = "mcap" | "mat" | "parquet" | "csv" | "ulg";

const FILE_S = 180;
const of = (name: string): string => `logs/${encodeURIComponent(name)}`;

export const listLogs = (): Promise<LogList> => get("logs");
export const logFacts = (name: string): Promise<LogFacts | (Unreadable & LogKept)> => get(of(name));
export const logSummary = (name: string): Promise<LogSummary | Unreadable> => get(`${of(name)}/summary`);
export const logReplay = (name: string): Promise<LogReplay> => get(`${of(name)}/replay`);
export const logSteps = (name: string): Promise<{ steps: LoggedStep[]; unclear: string }> => get(`${of(name)}/steps`);

/** A part of a log, or all of it: `points` of each curve. */
export function logView(name: string, window?: readonly [number, number], points = 2000): Promise<LogView> {
  const query = new URLSearchParams({ points: String(points) });
  if (window) {
    query.set("begin", String(window[0]));
    query.set("end", String(window[1]));
  }
  return get(`${of(name)}/view?${query}`);
}

/** Flights over each other. */
export function compareLogs(names: readonly string[], align: "step" | "start"): Promise<LogComparison> {
  const query = new URLSearchParams([["align", align], ...names.map((name) => ["name", name])]);
  return get(`logs/compare?${query}`);
}

/** The log as a file of a format. */
export async function logFile(name: string, form: Format): Promise<Blob> {
  return (await request("GET", `${of(name)}/file?form=${form}`, undefined, FILE_S)).blob();
}

/** Gives the server a log; answers the name under which it is kept. `sent` is told the share that is there, as it grows. */
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
