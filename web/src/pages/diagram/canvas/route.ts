// Where a wire bends, so that it runs through no block if that can be had with one leg moved.
import type { Point } from "../model/diagram";

export interface Box {
  readonly x: number;
  readonly y: number;
  readonly width: number;
  readonly height: number;
}
/** `x` of the upright leg of a wire that goes on to the right, or `y` of the level leg of one that goes back. */
export interface Route {
  readonly x?: number;
  readonly y?: number;
}

export const REACH = 20; // straight out of a port, and into one
const NAME = 16; // a block's name stands below it
const CLEAR = 3;

/** The bend of a wire between two ports that meets the fewest of the boxes; the shortest of those. */
export function routed(from: Point, to: Point, boxes: readonly Box[]): Route {
  const [left, right] = [from[0] + REACH, to[0] - REACH];
  if (left <= right) {
    const near = boxes.filter((box) => box.x < to[0] && box.x + box.width > from[0] && between(box, from[1], to[1]));
    const middle = (left + right) / 2;
    if (near.length === 0 || from[1] === to[1]) return { x: middle };
    const beside = near.flatMap((box) => [box.x - 15, box.x + box.width + 15]).filter((x) => x > left && x < right);
    const legs = [middle, right, left, ...beside.sort((a, b) => Math.abs(a - middle) - Math.abs(b - middle))];
    return { x: best(legs, near, (x) => [from, [x, from[1]], [x, to[1]], to]) };
  }
  const near = boxes.filter((box) => box.x < left && box.x + box.width > right);
  const middle = (from[1] + to[1]) / 2;
  const length = (y: number): number => Math.abs(y - from[1]) + Math.abs(y - to[1]);
  const around = near.flatMap((box) => [box.y - 12, box.y + box.height + NAME + 8]);
  const legs = [middle, ...around.sort((a, b) => length(a) - length(b))];
  return { y: best(legs, near, (y) => [from, [left, from[1]], [left, y], [right, y], [right, to[1]], to]) };
}

function between(box: Box, a: number, b: number): boolean {
  return box.y - CLEAR < Math.max(a, b) && box.y + box.height + CLEAR > Math.min(a, b);
}

function best(legs: readonly number[], boxes: readonly Box[], way: (leg: number) => readonly Point[]): number {
  let [found, fewest] = [legs[0]!, Infinity];
  for (const leg of legs) {
    const met = meets(way(leg), boxes);
    if (met < fewest) [found, fewest] = [leg, met];
    if (fewest === 0) break;
  }
  return found;
}

/** How many boxes lie on a way of level and upright legs. */
export function meets(way: readonly Point[], boxes: readonly Box[]): number {
  const on = (box: Box): boolean =>
    way.some((a, i) => {
      const b = way[i + 1];
      const beside = a[0] === b?.[0] ? CLEAR : 0; // a level leg begins and ends at a block
      return (
        b !== undefined &&
        Math.min(a[0], b[0]) - beside < box.x + box.width &&
        Math.max(a[0], b[0]) + beside > box.x &&
        between(box, a[1], b[1])
      );
    });
  return boxes.filter(on).length;
}
