/** Attributes of a control that is off for a reason: it is shown where one points, and read out. */
export interface Off {
  disabled?: true;
  title?: string;
  "aria-description"?: string;
}

/** A button that waits for what it, or another, has begun: a press does nothing, but the keyboard stays on it. */
export function waitsFor(why: string): Record<string, string> {
  return { "aria-disabled": "true", title: why, "aria-description": why };
}

/** A control is off for the first of these reasons that is not ""; where all are, nothing is changed. */
export function offFor(...reasons: readonly string[]): Off {
  const why = reasons.find((reason) => reason !== "");
  return why === undefined ? {} : { disabled: true, title: why, "aria-description": why };
}
