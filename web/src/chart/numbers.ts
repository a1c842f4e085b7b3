const MINUS = "\u2212";

/** A number for reading: four digits, no more than the axis shows; "none" where it is not one. */
export function figure(value: number, digits = 4): string {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  const minus = (text: string): string => text.replace("-", MINUS);
  // The sign of an exponent is the ordinary one, so that the number can be copied.
  if (size !== 0 && (size < 1e-3 || size >= 1e5)) return value.toExponential(2).replace(/^-/, MINUS);
  const whole = size < 1 ? 1 : Math.floor(Math.log10(size)) + 1;
  return minus(value.toFixed(Math.max(0, Math.min(4, digits - whole))));
}

/** A number that changes while it is read: as many decimals at each size, so that it does not jump. */
export function live(value: number, unit: string): string {
  if (!Number.isFinite(value)) return "–";
  const text = value.toFixed(unit === "" ? 4 : 3);
  return Number(text) === 0 ? text.replace("-", "") : text.replace("-", MINUS);
}

/** A number with its unit. */
export function quantity(value: number, unit: string): string {
  return unit ? `${figure(value)} ${unit}` : figure(value);
}
