// Requests to the server: an experiment, ready-made or with an excitation of one's own, and a fit of logs.
import type { ExperimentRequest, ExperimentRow, FitRequest } from "../../api/identification";
import type { Excitation } from "../../api/drones";

/** Group experiments in open and in closed loop. */
export function byLoop(rows: readonly ExperimentRow[]): readonly (readonly [string, ExperimentRow[]])[] {
  return [
    ["In open loop", rows.filter((row) => row.mode === "open-loop")],
    ["In closed loop", rows.filter((row) => row.mode !== "open-loop")],
  ];
}

export const experimentRequest = ({ name }: ExperimentRow, excitation: Excitation | undefined): ExperimentRequest =>
  excitation === undefined ? { name } : { name, excitation };

export function experimentOf(log: string, names: readonly string[]): string | undefined {
  const stem = log.replace(/\.\w+$/, "").replace(/-\d$/, "");
  return names.filter((name) => stem.endsWith(`-${name}`)).sort((a, b) => b.length - a.length)[0];
}

export const latestOf = (flights: readonly string[], name: string, names: readonly string[]): string | undefined =>
  flights.find((log) => experimentOf(log, names) === name);

/** Read a typed window [s]; undefined if it is empty, or why it is refused. */
export function windowOf(from: string, to: string): [number, number] | undefined | string {
  if (from.trim() === "" && to.trim() === "") return undefined;
  const [low, high] = [from, to].map((text) => Number(text.trim().replace(",", "."))) as [number, number];
  if (from.trim() === "" || to.trim() === "" || !Number.isFinite(low) || !Number.isFinite(high))
    return "Give both times of the window in seconds, or none.";
  return low < high && low >= 0 ? [low, high] : "The window must end after it begins.";
}

/** What is chosen for a fit; "" for nothing. */
export interface FitChoice {
  log: string;
  kind: string;
  structure: string;
  impulse: string;
  others: readonly string[];
  window: [number, number] | undefined;
  disturbance: string;
}

export function fitRequest({ log, kind, structure, impulse, others, window, disturbance }: FitChoice): FitRequest {
  return {
    log,
    structure,
    disturbance,
    others: others.filter((one) => one !== log),
    ...(kind === "" ? {} : { kind }),
    ...(impulse === "" || !["", "doublet"].includes(kind) ? {} : { impulse }),
    ...(window === undefined ? {} : { window }),
  };
}
