import { get, request, send } from "./client";

/** A parameter of a drone; `tuning`: to change it needs no lease. Values are in SI and radians. */
export interface ParameterRow {
  name: string;
  value: number;
  kind: "int32" | "float";
  default: number | null;
  low: number | null;
  high: number | null;
  unit: string;
  text: string;
  /** Where it stands in a user's controller that flies there, else "". */
  path: string;
  tuning: boolean;
  /** Our name of a number that this is only the real drone's name of, else "". */
  same_as: string;
}

export interface Change {
  name: string;
  before: number | null;
  value: number | null;
  unit?: string;
}

/** What differs from a file or snapshot, and what the drone lacks of it. */
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

export interface LoopMargins {
  stable: boolean;
  crossover: number | null;
  /** As a factor above 1. */
  gain_margin: number | null;
  /** [rad] */
  phase_margin: number | null;
  /** [s] */
  delay_margin: number | null;
  disk_margin: number | null;
}

/** What changed gains would do on the identified family. Angles in radians. */
export interface Preview {
  why: "";
  model: string;
  /** The user's controller that flies, "" for the stock one. */
  controller: string;
  touches: boolean;
  parameters: string[];
  unstable: boolean;
  confirm: string;
  goal: number;
  level: number;
  time: number[];
  bands: Record<"theta" | "q" | "M", { low: number[]; middle: number[]; high: number[] }>;
  loops: Record<string, LoopMargins>;
  figures: Record<string, Interval>;
  verdict: { robust: boolean; text: string };
}

/** A step of theta that was flown, scaled to the goal that was asked for. */
export interface MeasuredStep {
  at: number;
  size: number;
  time: number[];
  theta: number[];
  figures: Record<string, number | null>;
}

export interface Snapshot {
  name: string;
  /** Unix time [s]. */
  kept: number;
}

const at = (drone: number) => `drones/${drone}/parameters`;

export const listParameters = (drone: number) => get<ParameterRow[]>(at(drone));

/** All or none of them; `confirm` is the token of a preview that showed what is not kept stable. */
export function changeParameters(drone: number, changes: Record<string, number>, confirm = "") {
  const query = confirm === "" ? "" : `?confirm=${encodeURIComponent(confirm)}`;
  return send<{ changed: Change[] }>("PATCH", `${at(drone)}${query}`, changes);
}

/** Takes the last change back; the guard looks at it as at any change. */
export const undoChange = (drone: number) => send<{ changed: Change[] }>("POST", `${at(drone)}/undo`);

export const guardOf = (drone: number) => get<{ model: string | null; controller: string }>(`tuning/${drone}`);

export const chooseGuard = (drone: number, model: string | null) =>
  send<{ model: string | null }>("PUT", `tuning/${drone}/model`, { model });

/** Why there is no preview. */
export interface NoPreview {
  why: string;
  model: string;
}

/** Takes a second of the server's time, and more where it is busy. */
export async function previewTuning(
  drone: number,
  changes: Record<string, number>,
  goal: number,
): Promise<Preview | NoPreview> {
  const answer = await request("POST", `tuning/${drone}/preview`, { changes, goal }, 90);
  return (await answer.json()) as Preview | NoPreview;
}

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

/** A file that QGroundControl loads: of the drone as it is, or of a snapshot. */
export async function parameterFile(drone: number, snapshot = ""): Promise<Blob> {
  const place = snapshot === "" ? "file" : `snapshots/${encodeURIComponent(snapshot)}/file`;
  return (await request("GET", `${at(drone)}/${place}`)).blob();
}

/** What a file would change; nothing is changed yet. */
export async function compareFile(drone: number, file: Blob): Promise<Comparison> {
  return (await (await request("POST", `${at(drone)}/file`, file)).json()) as Comparison;
}
