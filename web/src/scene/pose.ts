/** Where the drone is on its rail, SI: x along the rail with 0 at its middle, theta > 0 nose-up. */
export interface Place {
  x: number;
  theta: number;
}

/** What the scene shows. */
export interface Pose extends Place {
  /** Commands of the fore and the aft rotor pair, 0 to 1. */
  fore: number;
  aft: number;
  /** The rings lock the cart: only the pitch moves. */
  rings?: boolean;
}

/** What is asked for, as far as a loop follows it. */
export interface Wanted {
  x?: number | undefined;
  theta?: number | undefined;
}

/** The commands of the rotor pairs for a thrust T and a moment M, as the mixer gives them. */
export function pairs(T: number, M: number): { fore: number; aft: number } {
  const clip = (value: number): number => Math.min(1, Math.max(0, value));
  return { fore: clip(T + M), aft: clip(T - M) };
}
