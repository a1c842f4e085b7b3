// What was edited and not sent yet: groups, search, what differs, what cannot be.
import type { Change, ParameterRow } from "../../api/tuning";
import { boundsMistake, editableNumber, screenUnit, written } from "../../design/units";

export type Edits = ReadonlyMap<string, number>;

/** Larger bounds mean no bound. */
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

export function groupOf(row: ParameterRow): string {
  if (row.path !== "") return `Your controller: ${row.path.split(".")[0]!.replaceAll("_", " ")}`;
  return GROUPS.find(([start]) => row.name.startsWith(start))?.[1] ?? "Vehicle";
}

const REPLACED: Record<string, readonly string[]> = {
  attitude_control: ["Rate loop", "Attitude loop"],
  position_control: ["Velocity loop", "Position loop"],
};
const isReplaced = (rows: readonly ParameterRow[], group: string): boolean =>
  rows.some(({ path }) => REPLACED[path.split(".")[0]!]?.includes(group));

const TERMS = ["KP", "KI", "KD", "N"];
function term(row: ParameterRow): number {
  const at = TERMS.indexOf((row.path || row.name).toUpperCase().split(/[._]/).at(-1)!);
  return at < 0 ? TERMS.length : at;
}

/** Group rows of `all`, gains first. */
export function grouped(
  rows: readonly ParameterRow[],
  all = rows,
): readonly (readonly [group: string, rows: ParameterRow[]])[] {
  const order = ["Your controller", ...GROUPS.map(([, label]) => label), "Vehicle"];
  const found = new Map<string, ParameterRow[]>();
  for (const row of rows) {
    if (row.same_as !== "") continue;
    const group = groupOf(row) + (isReplaced(all, groupOf(row)) ? ": replaced by your controller" : "");
    found.set(group, [...(found.get(group) ?? []), row]);
  }
  for (const list of found.values()) list.sort((a, b) => term(a) - term(b) || a.name.localeCompare(b.name));
  const place = (group: string) => order.findIndex((one) => group === one || group.startsWith(`${one}:`));
  return [...found].sort(([a], [b]) => place(a) - place(b));
}

/** Return the rows that contain every word of `text` in name, path, help or alias. */
export function searched(rows: readonly ParameterRow[], text: string): ParameterRow[] {
  const words = text.toLowerCase().split(/\s+/).filter(Boolean);
  const others = new Map(rows.map((row) => [row.same_as, row.name]));
  return rows.filter((row) => {
    const said = `${row.name} ${row.path} ${row.text} ${groupOf(row)} ${others.get(row.name) ?? ""}`.toLowerCase();
    return words.every((word) => said.includes(word));
  });
}

/** Return whether two values are equal on the drone. */
export function same(row: ParameterRow, value: number, other: number | null): boolean {
  if (other === null) return false;
  return row.kind === "int32" ? Math.round(value) === other : Math.fround(value) === Math.fround(other);
}

/** Format the value of a parameter. */
export function shown(value: number | null, unit = ""): string {
  return value === null ? "–" : written(editableNumber(value, unit, 6));
}

export const lowOf = (row: ParameterRow) => (row.low === null || row.low < -BOUNDLESS ? -Infinity : row.low);
export const highOf = (row: ParameterRow) => (row.high === null || row.high > BOUNDLESS ? Infinity : row.high);

/** Return whether a parameter has a slider: a gain with bounds, or of a user's diagram. */
export const slides = (row: ParameterRow) =>
  row.tuning && row.kind === "float" && (row.path !== "" || Number.isFinite(highOf(row) - lowOf(row)));

/** Return the ends of the slider: the bounds; without any, or with wide ones of a user's diagram, twice the default. */
export function sliderEnds(row: ParameterRow): [low: number, high: number] {
  const [low, high] = [lowOf(row), highOf(row)];
  const twice = 2 * (row.default || row.value);
  const [least, most] = twice === 0 ? [-1, 1] : [Math.min(0, twice), Math.max(0, twice)];
  const near = (bound: number) =>
    Number.isFinite(bound) && (row.path === "" || twice === 0 || Math.abs(bound) <= Math.abs(2 * twice));
  return [
    near(low) ? low : Math.max(low, Math.min(least, row.value, high)),
    near(high) ? high : Math.min(high, Math.max(most, row.value, low)),
  ];
}

/** Write the bounds of a parameter. */
export function boundsText(row: ParameterRow): string {
  const [low, high] = [lowOf(row), highOf(row)].map((bound) => (Number.isFinite(bound) ? shown(bound, row.unit) : ""));
  if (low === "" && high === "") return "no bounds";
  const text = low === "" ? `at most ${high}` : high === "" ? `at least ${low}` : `${low} to ${high}`;
  return `${text} ${screenUnit(row.unit).name}`.trim();
}

/** Return why a value is refused, or "". */
export function mistake(row: ParameterRow, value: number): string {
  if (row.kind === "int32" && !Number.isInteger(value)) return "Give a whole number.";
  return boundsMistake(value, row.unit, lowOf(row), highOf(row));
}

/** Return the changes of the edits. */
export function differences(rows: readonly ParameterRow[], edits: Edits): Change[] {
  return rows
    .filter((row) => edits.has(row.name) && !same(row, edits.get(row.name)!, row.value))
    .map(({ name, label, value, unit }) => ({ name, label, before: value, value: edits.get(name)!, unit }));
}

/** Add the changes of a file or snapshot to the edits. */
export function withChanges(rows: readonly ParameterRow[], edits: Edits, changes: readonly Change[]): Edits {
  const known = new Set(rows.map((row) => row.name));
  const next = new Map(edits);
  for (const { name, value } of changes) if (value !== null && known.has(name)) next.set(name, value);
  return next;
}

export function asRecord(changes: readonly Change[]): Record<string, number> {
  return Object.fromEntries(changes.map(({ name, value }) => [name, value!]));
}
