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
const FAR = 400; // above and below its ports a wire that goes back looks for a way
const MOST_LEGS = 24; // tried: what a wire through a crowd costs is bounded

/** The boxes that a wire between two ports may meet are those that touch this one. */
export function region(from: Point, to: Point): Box {
  const [left, right] = [from[0] + REACH, to[0] - REACH];
  const top = Math.min(from[1], to[1]) - CLEAR;
  const height = Math.abs(from[1] - to[1]) + 2 * CLEAR;
  if (left <= right) return { x: from[0], y: top, width: to[0] - from[0], height };
  return { x: right, y: top - FAR, width: left - right, height: height + 2 * FAR };
}

/** The bend of a wire between two ports that meets the fewest of the boxes; the shortest of those. */
export function routed(from: Point, to: Point, boxes: readonly Box[]): Route {
  const [left, right] = [from[0] + REACH, to[0] - REACH];
  const around = region(from, to);
  const near = boxes.filter((box) => touch(box, around));
  if (left <= right) {
    const middle = (left + right) / 2;
    if (near.length === 0 || from[1] === to[1]) return { x: middle };
    const beside = near.flatMap((box) => [box.x - 15, box.x + box.width + 15]).filter((x) => x > left && x < right);
    const legs = nearest(beside, middle, (x) => Math.abs(x - middle));
    return {
      x: best([middle, right, left, ...legs], near, (x) => [from, [x, from[1]], [x, to[1]], to]),
    };
  }
  const middle = (from[1] + to[1]) / 2;
  const length = (y: number): number => Math.abs(y - from[1]) + Math.abs(y - to[1]);
  const beyond = near.flatMap((box) => [box.y - 12, box.y + box.height + NAME + 8]);
  const legs = nearest(beyond, middle, length);
  return {
    y: best([middle, ...legs], near, (y) => [from, [left, from[1]], [left, y], [right, y], [right, to[1]], to]),
  };
}

/** The legs that are tried: each once, the shortest ones. */
function nearest(legs: readonly number[], middle: number, length: (leg: number) => number): number[] {
  const rated = [...new Set(legs)].filter((leg) => leg !== middle).map((leg) => [leg, length(leg)] as const);
  return rated
    .sort((a, b) => a[1] - b[1] || a[0] - b[0]) // not by the boxes' order
    .slice(0, MOST_LEGS)
    .map(([leg]) => leg);
}

export function touch(a: Box, b: Box): boolean {
  return a.x < b.x + b.width && a.x + a.width > b.x && a.y < b.y + b.height && a.y + a.height > b.y;
}

function best(legs: readonly number[], boxes: readonly Box[], way: (leg: number) => readonly Point[]): number {
  let [found, fewest] = [legs[0]!, Infinity];
  for (const leg of legs) {
    const met = meets(way(leg), boxes, fewest);
    if (met < fewest) [found, fewest] = [leg, met];
    if (fewest === 0) break;
  }
  return found;
}

/** How many boxes lie on a way of level and upright legs; counted up to `enough`. */
export function meets(way: readonly Point[], boxes: readonly Box[], enough = Infinity): number {
  let met = 0;
  for (const box of boxes) {
    if (on(way, box)) met++;
    if (met >= enough) break;
  }
  return met;
}

function on(way: readonly Point[], box: Box): boolean {
  for (let i = 0; i + 1 < way.length; i++) {
    const [a, b] = [way[i]!, way[i + 1]!];
    const beside = a[0] === b[0] ? CLEAR : 0; // a level leg begins and ends at a block
    if (
      Math.min(a[0], b[0]) - beside < box.x + box.width &&
      Math.max(a[0], b[0]) + beside > box.x &&
      box.y - CLEAR < Math.max(a[1], b[1]) &&
      box.y + box.height + CLEAR > Math.min(a[1], b[1])
    )
      return true;
  }
  return false;
}
