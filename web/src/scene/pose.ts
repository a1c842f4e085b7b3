/** Place on the rail, SI: x = 0 in the middle, theta > 0 nose-up. */
export interface Place {
  x: number;
  theta: number;
}

export interface Pose extends Place {
  fore: number;
  aft: number;
  rings?: boolean;
}

/** Set-points of closed loops. */
export interface Wanted {
  x?: number | undefined;
  theta?: number | undefined;
}

/** Return the commands of the rotor pairs, as the mixer does. */
export function pairs(T: number, M: number): { fore: number; aft: number } {
  const clip = (value: number): number => Math.min(1, Math.max(0, value));
  return { fore: clip(T + M), aft: clip(T - M) };
}
