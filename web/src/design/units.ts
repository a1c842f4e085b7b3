// Radians and SI inside, degrees on the screen.

/** Unit on the screen, with the factor from SI. */
export interface ScreenUnit {
  name: string;
  factor: number;
  decimals: number;
}

/** Degrees per radian. */
export const DEGREES = 180 / Math.PI;
const SHOWN: Record<string, ScreenUnit> = {
  rad: { name: "deg", factor: DEGREES, decimals: 2 },
  "rad/s": { name: "deg/s", factor: DEGREES, decimals: 1 },
  // An angular frequency, as a Bode plot has it: nobody reads those in degrees.
  "radian/s": { name: "rad/s", factor: 1, decimals: 1 },
  "rad/s^2": { name: "deg/s²", factor: DEGREES, decimals: 0 },
  "m/s^2": { name: "m/s²", factor: 1, decimals: 3 },
  m: { name: "m", factor: 1, decimals: 3 },
  "m/s": { name: "m/s", factor: 1, decimals: 3 },
  s: { name: "s", factor: 1, decimals: 3 },
  Hz: { name: "Hz", factor: 1, decimals: 2 },
  V: { name: "V", factor: 1, decimals: 2 },
  "%": { name: "%", factor: 100, decimals: 0 },
  "-": { name: "", factor: 1, decimals: 4 },
  "": { name: "", factor: 1, decimals: 4 },
};

/** Return the unit of the screen for an SI unit. `=rad/s` stays rad/s. */
export function screenUnit(unit: string): ScreenUnit {
  if (unit.startsWith("=")) return { name: raised(unit.slice(1)), factor: 1, decimals: 4 };
  return SHOWN[unit] ?? { name: raised(unit), factor: 1, decimals: 4 };
}

/** Write `s^2/rad` and `rad/s2` with a raised 2. */
export const raised = (unit: string): string => unit.replace(/\^2|(?<=[a-z])2\b/g, "²");

/** Shorten a parameter written with all digits, such as `0.0654030728 s2/rad, 0 to inf`. */
export function brief(text: string): string {
  const short = text.replace(/-?\d+\.\d+(e[-+]\d+)?/g, (number) => String(Number(Number(number).toPrecision(4))));
  const bounds = short.replace(/(\S+) to inf/, "at least $1").replace(/-inf to (\S+)/, "at most $1");
  return raised(bounds).replace(/(?<!\w)-(?=\d)/g, MINUS);
}

/** Convert a factor to decibels; null stays null. */
export const decibels = (factor: number | null): number | null => (factor === null ? null : 20 * Math.log10(factor));

const MINUS = "\u2212";

/** Write a number with a typographic minus; no minus before 0. */
export function written(digits: string): string {
  // The sign of an exponent stays the ordinary one, so that the number can be copied.
  return digits.replace(/^-/, Number(digits) === 0 ? "" : MINUS);
}

/** Write a value with the decimals that show two digits of its standard deviation; with four digits without one. */
export function withSpread(value: number | null, sigma: number | null): string {
  if (value === null) return "–";
  if (!sigma) return written(value.toPrecision(4));
  return written(value.toFixed(Math.min(12, Math.max(0, 1 - Math.floor(Math.log10(sigma))))));
}

/** Format a value in the unit of the screen, without the unit; a dash if it is not a number. */
export function shownNumber(value: number | null | undefined, unit = "", decimals?: number): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const { factor, decimals: usual } = screenUnit(unit);
  return written((value * factor).toFixed(decimals ?? usual));
}

export function shownValue(value: number | null | undefined, unit = "", decimals?: number): string {
  const { name } = screenUnit(unit);
  return shownNumber(value, unit, decimals) + (name && (name === "%" ? "%" : `\u00a0${name}`));
}

/** Format a value for editing: no trailing zeros, an ordinary minus. */
export function editableNumber(value: number, unit = "", decimals?: number): string {
  if (!Number.isFinite(value)) return "";
  const { factor, decimals: usual } = screenUnit(unit);
  const shown = value * factor;
  // A small number keeps its digits: 0.0004 must not become 0.
  const digits = Math.max(
    decimals ?? usual,
    shown === 0 ? 0 : Math.min(12, 2 - Math.floor(Math.log10(Math.abs(shown)))),
  );
  return String(Number(shown.toFixed(digits)));
}

/** Read a typed number, in SI; NaN if it is not one. Accepts a decimal comma. */
export function readNumber(text: string, unit = ""): number {
  const plain = text.trim().replace(",", ".").replace(MINUS, "-");
  return plain === "" ? NaN : Number(plain) / screenUnit(unit).factor;
}

/** Return why a value is refused, or "". */
export function boundsMistake(value: number, unit: string, low: number, high: number): string {
  if (!Number.isFinite(value)) return "Give a number.";
  // A bound typed as it is shown, such as 50 deg, must not fail by the last digit of pi.
  const slack = 1e-9 * Math.max(1, ...[low, high].filter(Number.isFinite).map(Math.abs));
  if (value >= low - slack && value <= high + slack) return "";
  const { name } = screenUnit(unit);
  const [least, most] = [low, high].map((bound) => written(editableNumber(bound, unit)));
  const suffix = name ? ` ${name}` : "";
  if (low === -Infinity) return `At most ${most}${suffix}.`;
  if (high === Infinity) return `At least ${least}${suffix}.`;
  return `From ${least} to ${most}${suffix}.`;
}
