import { get, request, send } from "./client";
import type { LoopMargins } from "./diagrams";

/** Parameter of a drone, SI and radians. Changing a `tuning` one needs no lease. */
export interface ParameterRow {
  name: string;
  value: number;
  kind: "int32" | "float";
  default: number | null;
  low: number | null;
  high: number | null;
  unit: string;
  text: string;
  label: string;
  /** Path in the user's controller, else "". */
  path: string;
  tuning: boolean;
  /** Name of the parameter that this is an alias of, else "". */
  same_as: string;
}

export interface Change {
  name: string;
  label?: string;
  before: number | null;
  value: number | null;
  unit?: string;
}

/** Differences from a file or snapshot, and parameters that the drone lacks. */
export interface Comparison {
  changes: Change[];
  missing: string[];
  about: Record<string, string>;
}

export interface Interval {
  low: number | null;
  middle: number | null;
  high: number | null;
}

/** Band of the step of theta that changed gains fly on the identified model. */
export interface PredictedStep {
  why: "";
  goal: number;
  level: number;
  time: number[];
  bands: Record<"theta", { low: number[]; middle: number[]; high: number[] }>;
}

/** Prediction of changed gains, with margins and verdict. */
export interface Preview extends PredictedStep {
  model: string;
  /** User's controller, "" for the stock one. */
  controller: string;
  touches: boolean;
  unstable: boolean;
  confirm: string;
  loops: Record<string, LoopMargins>;
  figures: Record<string, Interval>;
  /** The disk margin is that of the worst drone found. */
  verdict: { robust: boolean; text: string; disk_margin_deg: number };
}

export interface MeasuredStep {
  at: number;
  time: number[];
  theta: number[];
}

export interface Snapshot {
  name: string;
  /** Unix time [s]. */
  kept: number;
}

const at = (drone: number) => `drones/${drone}/parameters`;

export async function listParameters(drone: number): Promise<ParameterRow[]> {
  return (await get<ParameterRow[]>(at(drone))).map(labelled);
}

/** Label a parameter: one of a user's diagram by its path there, in the unit that the diagram declares. */
export function labelled(row: Omit<ParameterRow, "label">): ParameterRow {
  // A filter's corner is an angular frequency: rad/s, as a Bode plot has it.
  const unit = row.path || /\bcorner\b/.test(row.text) ? `=${row.unit}` : row.unit;
  if (row.path === "") return { ...row, label: row.name, unit };
  const label = row.path.slice(row.path.indexOf(".") + 1);
  const text = row.text.startsWith(row.path) ? row.text.slice(row.path.length).replace(/^: /, "") : row.text;
  return { ...row, label, text, unit };
}

/** Change all parameters or none; `confirm` is the token of an unstable preview. */
export function changeParameters(drone: number, changes: Record<string, number>, confirm = "") {
  const query = confirm === "" ? "" : `?confirm=${encodeURIComponent(confirm)}`;
  return send<{ changed: Change[] }>("PATCH", `${at(drone)}${query}`, changes);
}

export const undoChange = (drone: number) => send<{ changed: Change[] }>("POST", `${at(drone)}/undo`);

export const guardOf = (drone: number) =>
  get<{ model: string | null; controller: string; undo: Change[] }>(`tuning/${drone}`);

export const chooseGuard = (drone: number, model: string | null) =>
  send<{ model: string | null }>("PUT", `tuning/${drone}/model`, { model });

export const previewTuning = (drone: number, changes: Record<string, number>, goal: number) =>
  send<Preview | { why: string }>("POST", `tuning/${drone}/preview`, { changes, goal }, 90);

/** Predict the step alone, fast enough to follow a slider. */
export const predictStep = (drone: number, changes: Record<string, number>, goal: number) =>
  send<PredictedStep | { why: string }>("POST", `tuning/${drone}/step`, { changes, goal });

export const measuredSteps = (drone: number, log: string, goal: number) =>
  send<{ log: string; steps: MeasuredStep[] }>("POST", `tuning/${drone}/measured`, { log, goal });

export const listSnapshots = (drone: number) => get<Snapshot[]>(`${at(drone)}/snapshots`);
export const keepSnapshot = (drone: number, name: string, note: string) =>
  send<Snapshot>("POST", `${at(drone)}/snapshots`, { name, note });
export const deleteSnapshot = (drone: number, name: string) =>
  send<undefined>("DELETE", `${at(drone)}/snapshots/${encodeURIComponent(name)}`);
export const compareSnapshot = (drone: number, name: string, other = "") =>
  get<Comparison>(
    `${at(drone)}/snapshots/${encodeURIComponent(name)}${other && `?other=${encodeURIComponent(other)}`}`,
  );

export async function parameterFile(drone: number, snapshot = ""): Promise<Blob> {
  const place = snapshot === "" ? "file" : `snapshots/${encodeURIComponent(snapshot)}/file`;
  return (await request("GET", `${at(drone)}/${place}`)).blob();
}

export const compareFile = (drone: number, file: Blob) => send<Comparison>("POST", `${at(drone)}/file`, file);
