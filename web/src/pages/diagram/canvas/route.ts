// Bends of wires: each wire moves one leg so that it crosses as few blocks as possible.
import type { Point } from "../model/diagram";

export interface Box {
  readonly x: number;
  readonly y: number;
  readonly width: number;
  readonly height: number;
}
/** The `x` of the vertical leg of a forward wire, or the `y` of the horizontal leg of a feedback wire. */
export interface Route {
  readonly x?: number;
  readonly y?: number;
}

export const REACH = 20; // straight part at each port
const NAME = 16; // height of the name below a block
const CLEAR = 3;
const FAR = 400; // search range of a feedback wire above and below its ports
const MOST_LEGS = 24; // candidates per wire

/** Return the area in which a wire between two ports may run. */
function region(from: Point, to: Point): Box {
  const [left, right] = [from[0] + REACH, to[0] - REACH];
  const top = Math.min(from[1], to[1]) - CLEAR;
  const height = Math.abs(from[1] - to[1]) + 2 * CLEAR;
  if (left <= right) return { x: from[0], y: top, width: to[0] - from[0], height };
  return { x: right, y: top - FAR, width: left - right, height: height + 2 * FAR };
}

/** Return the bend that crosses the fewest boxes; among equals the shortest. */
export function routed(from: Point, to: Point, boxes: readonly Box[]): Route {
  const [left, right] = [from[0] + REACH, to[0] - REACH];
  const around = region(from, to);
  const near = boxes.filter((box) => touch(box, around));
  if (left <= right) {
    const middle = (left + right) / 2;
    if (near.length === 0 || from[1] === to[1]) return { x: middle };
    const beside = near.flatMap((box) => [box.x - 15, box.x + box.width + 15]).filter((x) => x > left && x < right);
    const legs = nearest(beside, middle, (x) => Math.abs(x - middle));
    return { x: best([middle, right, left, ...legs], near, (x) => [from, [x, from[1]], [x, to[1]], to]) };
  }
  const middle = (from[1] + to[1]) / 2;
  const length = (y: number): number => Math.abs(y - from[1]) + Math.abs(y - to[1]);
  const beyond = near.flatMap((box) => [box.y - 12, box.y + box.height + NAME + 8]);
  const legs = nearest(beyond, middle, length);
  return {
    y: best([middle, ...legs], near, (y) => [from, [left, from[1]], [left, y], [right, y], [right, to[1]], to]),
  };
}

/** Return the shortest candidate legs, each once. */
function nearest(legs: readonly number[], middle: number, length: (leg: number) => number): number[] {
  const rated = [...new Set(legs)].filter((leg) => leg !== middle).map((leg) => [leg, length(leg)] as const);
  return rated
    .sort((a, b) => a[1] - b[1] || a[0] - b[0]) // not by the boxes' order
    .slice(0, MOST_LEGS)
    .map(([leg]) => leg);
}

function touch(a: Box, b: Box): boolean {
  return a.x < b.x + b.width && a.x + a.width > b.x && a.y < b.y + b.height && a.y + a.height > b.y;
}

function best(legs: readonly number[], boxes: readonly Box[], way: (leg: number) => readonly Point[]): number {
  const met = legs.map((leg) => [leg, meets(way(leg), boxes)] as const);
  return met.reduce((found, one) => (one[1] < found[1] ? one : found))[0];
}

/** Count the boxes on a path of horizontal and vertical legs. */
export function meets(way: readonly Point[], boxes: readonly Box[]): number {
  return boxes.filter((box) => on(way, box)).length;
}

function on(way: readonly Point[], box: Box): boolean {
  for (let i = 0; i + 1 < way.length; i++) {
    const [a, b] = [way[i]!, way[i + 1]!];
    const beside = a[0] === b[0] ? CLEAR : 0; // a horizontal leg begins and ends at a block
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

/** Ends of a wire. Between two flipped blocks it runs to the left; between a flipped and another one it turns round. */
export interface Ends {
  readonly id: string;
  readonly from: Point;
  readonly to: Point;
  readonly way: "right" | "left" | "round";
}

interface Routed extends Ends {
  readonly route: Route;
  readonly done: boolean;
}

/** Router for the wires of a sheet. Keeps a route until an end of the wire or a block near it moves. */
export class Router {
  private boxes: ReadonlyMap<string, Box> = new Map();
  private wires: ReadonlyMap<string, Routed> = new Map();

  /** Route new and changed wires for at most `milliseconds`. Returns true if some are left for the next call. */
  update(boxes: ReadonlyMap<string, Box>, ends: readonly Ends[], milliseconds: number): boolean {
    const until = performance.now() + milliseconds;
    const changed = moved(this.boxes, boxes);
    const all = [...boxes.values()];
    this.boxes = boxes;
    const route = (wire: Ends): Routed => {
      const was = this.wires.get(wire.id);
      const same = was?.way === wire.way && String([was.from, was.to]) === String([wire.from, wire.to]);
      if (same && was.done && !changed.some((box) => touch(box, area(wire)))) return was;
      if (wire.way === "round") return { ...wire, route: {}, done: true };
      if (performance.now() >= until) return { ...wire, route: same ? was.route : {}, done: false };
      return { ...wire, route: bend(wire, all), done: true };
    };
    this.wires = new Map(ends.map((wire) => [wire.id, route(wire)]));
    return [...this.wires.values()].some((wire) => !wire.done);
  }

  route(id: string): Route {
    return this.wires.get(id)?.route ?? {};
  }
}

/** Return the old and the new places of boxes that came, went or moved. */
function moved(before: ReadonlyMap<string, Box>, after: ReadonlyMap<string, Box>): Box[] {
  const unlike = (one: ReadonlyMap<string, Box>, other: ReadonlyMap<string, Box>): Box[] =>
    [...one].flatMap(([id, box]) => {
      const there = other.get(id);
      const alike = there?.x === box.x && there.y === box.y && there.width === box.width && there.height === box.height;
      return alike ? [] : [box];
    });
  return [...unlike(before, after), ...unlike(after, before)];
}

// A wire to the left is routed as its mirror image.
const mirror = ([x, y]: Point): Point => [-x, y];
const mirrored = (box: Box): Box => ({ ...box, x: -box.x - box.width });

function area({ from, to, way }: Ends): Box {
  return way === "left" ? mirrored(region(mirror(from), mirror(to))) : region(from, to);
}

function bend({ from, to, way }: Ends, boxes: readonly Box[]): Route {
  if (way === "right") return routed(from, to, boxes);
  const { x, y } = routed(mirror(from), mirror(to), boxes.map(mirrored));
  return { ...(x === undefined ? {} : { x: -x }), ...(y === undefined ? {} : { y }) };
}
