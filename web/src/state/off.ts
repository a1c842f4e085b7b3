/** Attributes of a control that is off for a reason. */
export interface Off {
  disabled?: true;
  title?: string;
  "aria-description"?: string;
}

/** Return the attributes of a button that waits but keeps the focus. */
export function waitsFor(why: string): Record<string, string> {
  return { "aria-disabled": "true", title: why, "aria-description": why };
}

/** Switch a control off for the first reason that is not "". */
export function offFor(...reasons: readonly string[]): Off {
  const why = reasons.find((reason) => reason !== "");
  return why === undefined ? {} : { disabled: true, title: why, "aria-description": why };
}
