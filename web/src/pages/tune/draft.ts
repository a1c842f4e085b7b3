// What was edited and not sent yet: groups, search, what differs, what cannot be.
import type { Change, ParameterRow } from "../../api/tuning";
import { boundsMistake } from "../../design/units";

/** New values by name, in SI. */
export type Edits = ReadonlyMap<string, number>;

/** Beyond what a float32 holds as a bound: the parameter has none. */
const BOUNDLESS = 3e38;

const GROUPS: readonly [start: string, label: string][] = [
  ["RATE_", "Rate loop"],
  ["ATT_", "Attitude loop"],
  ["VEL_", "Velocity loop"],
  ["POS_", "Position loop"],
  ["THRUST_", "Thrust and limits"],
  ["M_MAX", "Thrust and limits"],
  ["X0_MAX", "Thrust and limits"],
  ["SAFE_", "Failsafe"],
];

/** Which group a parameter stands in: that of its controller's block, of its name, or the rest. */
export function groupOf(row: ParameterRow): string {
  if (row.path !== "") return `Own: ${row.path.split(".")[0]!.replaceAll("_", " ")}`;
  return GROUPS.find(([start]) => row.name.startsWith(start))?.[1] ?? "Vehicle";
}

/** Of a controller's gains the proportional one first, as everybody writes them. */
const TERMS = ["KP", "KI", "KD", "N"];
function term(row: ParameterRow): number {
  const at = TERMS.indexOf((row.path || row.name).toUpperCase().split(/[._]/).at(-1)!);
  return at < 0 ? TERMS.length : at;
}

/** The groups with their rows: what is tuned first, the failsafe and the vehicle last. */
export function grouped(rows: readonly ParameterRow[]): readonly (readonly [group: string, rows: ParameterRow[]])[] {
  const order = ["Own", ...GROUPS.map(([, label]) => label), "Vehicle"];
  const found = new Map<string, ParameterRow[]>();
  for (const row of rows) {
    if (row.same_as !== "") continue;
    found.set(groupOf(row), [...(found.get(groupOf(row)) ?? []), row]);
  }
  for (const list of found.values()) list.sort((a, b) => term(a) - term(b) || a.name.localeCompare(b.name));
  const place = (group: string) => order.findIndex((one) => group === one || group.startsWith(`${one}:`));
  return [...found].sort(([a], [b]) => place(a) - place(b));
}

/** The rows that hold every word of `text` in name, path, help, or the real drone's name. */
export function searched(rows: readonly ParameterRow[], text: string): ParameterRow[] {
  const words = text.toLowerCase().split(/\s+/).filter(Boolean);
  const others = new Map<string, string>();
  for (const row of rows) if (row.same_as !== "") others.set(row.same_as, row.name);
  return rows.filter((row) => {
    const said = `${row.name} ${row.path} ${row.text} ${groupOf(row)} ${others.get(row.name) ?? ""}`.toLowerCase();
    return words.every((word) => said.includes(word));
  });
}

/** Whether two values are one where they are kept: a float32, or a whole number. */
export function same(row: ParameterRow, value: number, other: number | null): boolean {
  if (other === null) return false;
  return row.kind === "int32" ? Math.round(value) === other : Math.fround(value) === Math.fround(other);
}

export const lowOf = (row: ParameterRow) => (row.low === null || row.low < -BOUNDLESS ? -Infinity : row.low);
export const highOf = (row: ParameterRow) => (row.high === null || row.high > BOUNDLESS ? Infinity : row.high);

/** Why a value is not taken, "" where it is. */
export function mistake(row: ParameterRow, value: number): string {
  if (row.kind === "int32" && !Number.isInteger(value)) return "Give a whole number.";
  return boundsMistake(value, row.unit, lowOf(row), highOf(row));
}

/** What sending the edits would change, in the order of the rows; edits back to the present value are none. */
export function differences(rows: readonly ParameterRow[], edits: Edits): Change[] {
  return rows
    .filter((row) => edits.has(row.name) && !same(row, edits.get(row.name)!, row.value))
    .map((row) => ({ name: row.name, before: row.value, value: edits.get(row.name)!, unit: row.unit }));
}

/** The edits with those of a file or snapshot, as far as the drone has them. */
export function withChanges(rows: readonly ParameterRow[], edits: Edits, changes: readonly Change[]): Edits {
  const known = new Set(rows.map((row) => row.name));
  const next = new Map(edits);
  for (const { name, value } of changes) if (value !== null && known.has(name)) next.set(name, value);
  return next;
}

/** As the server takes them. */
export function asRecord(changes: readonly Change[]): Record<string, number> {
  return Object.fromEntries(changes.map(({ name, value }) => [name, value!]));
}
