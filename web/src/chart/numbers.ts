import { written } from "../design/units";

/** A number for reading: four digits, no more than the axis shows; "none" where it is not one. */
export function figure(value: number, digits = 4): string {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-3 || size >= 1e5)) return written(value.toExponential(2));
  const whole = size < 1 ? 1 : Math.floor(Math.log10(size)) + 1;
  return written(value.toFixed(Math.max(0, Math.min(4, digits - whole))));
}

/** A number that changes while it is read: as many decimals at each size, so that it does not jump. */
export function live(value: number, unit: string): string {
  if (!Number.isFinite(value)) return "–";
  return written(value.toFixed(unit === "" ? 4 : 3));
}

/** A number at a tick of an axis; "" where a logarithmic axis leaves one out. */
export function tick(value: number | null): string {
  return value === null ? "" : written(String(Number(value.toPrecision(10))));
}

/** A number with its unit. */
export function quantity(value: number, unit: string): string {
  return unit ? `${figure(value)} ${unit}` : figure(value);
}
