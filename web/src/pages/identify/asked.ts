// What is asked of the server: an experiment, ready-made or with an excitation of one's own, and which logs fit.
import type { ExperimentAsked, ExperimentRow, FitAsked } from "../../api/identification";
import type { Excitation } from "../../api/drones";

/** The experiments by what moves the drone: the moment itself, or the set-point of a controller. */
export function byLoop(rows: readonly ExperimentRow[]): readonly (readonly [string, ExperimentRow[]])[] {
  return [
    ["In open loop", rows.filter((row) => row.mode === "open-loop")],
    ["In closed loop", rows.filter((row) => row.mode !== "open-loop")],
  ];
}

/** The experiment as it is asked for; `own` takes the place of its excitation. */
export function experimentAsked(row: ExperimentRow, own: Excitation | undefined): ExperimentAsked {
  return own === undefined ? { name: row.name } : { name: row.name, excitation: own };
}

/** Of a log's name which experiment it holds, where the name says so: those that this page flew. */
export function experimentOf(log: string, names: readonly string[]): string | undefined {
  const stem = log.replace(/\.\w+$/, "").replace(/-\d$/, "");
  return names
    .filter((name) => stem.endsWith(`-${name}`))
    .sort((a, b) => b.length - a.length)
    .at(0);
}

/** The newest log of an experiment among `flights`, which are the newest first. */
export function latestOf(flights: readonly string[], name: string, names: readonly string[]): string | undefined {
  return flights.find((log) => experimentOf(log, names) === name);
}

/** A window that was typed, in seconds: undefined where both fields are empty; a sentence where it is none. */
export function windowOf(from: string, to: string): [number, number] | undefined | string {
  if (from.trim() === "" && to.trim() === "") return undefined;
  const [low, high] = [from, to].map((text) => Number(text.trim().replace(",", "."))) as [number, number];
  if (from.trim() === "" || to.trim() === "" || !Number.isFinite(low) || !Number.isFinite(high))
    return "Give both times of the window in seconds, or none.";
  return low < high && low >= 0 ? [low, high] : "The window must end after it begins.";
}

/** A fit as it is asked for: what is empty is left to the library. */
export function fitAsked(given: {
  log: string;
  kind: string;
  structure: string;
  impulse: string;
  others: readonly string[];
  window: [number, number] | undefined;
  disturbance: string;
}): FitAsked {
  const { log, kind, structure, impulse, others, window, disturbance } = given;
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
