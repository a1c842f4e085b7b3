import { written } from "../design/units";

/** Format a number with four digits. */
export function figure(value: number, digits = 4): string {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-3 || size >= 1e5)) return written(value.toExponential(2));
  const whole = size < 1 ? 1 : Math.floor(Math.log10(size)) + 1;
  return written(value.toFixed(Math.max(0, Math.min(4, digits - whole))));
}

/** Format a changing number with a fixed number of decimals. */
export function live(value: number, unit: string): string {
  if (!Number.isFinite(value)) return "–";
  return written(value.toFixed(unit === "" ? 4 : 3));
}

/** Format a number at a tick; "" if a logarithmic axis omits it. */
export const tick = (value: number | null): string =>
  value === null ? "" : written(String(Number(value.toPrecision(10))));

export const quantity = (value: number, unit: string): string => `${figure(value)} ${unit}`.trimEnd();

/** Return the first row from `low` on that is `at` or behind a place; `high` if none is. Rows are in order. */
export function firstRow(low: number, high: number, at: (row: number) => boolean): number {
  while (low < high) {
    const middle = (low + high) >>> 1;
    if (at(middle)) high = middle;
    else low = middle + 1;
  }
  return low;
}
