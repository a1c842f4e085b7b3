// The bends of all wires of a sheet. What did not change is kept, and what is new is found in slices: a paste of hundreds
// of blocks must not hold the page up. Until then a wire bends in its middle.
import type { Point } from "../model/diagram";
import { region, routed, touch, type Box, type Route } from "./route";

export interface Ends {
  readonly id: string;
  readonly from: Point;
  readonly to: Point;
  /** Where it leaves and comes in to the right, or, between two flipped blocks, to the left; else it turns round. */
  readonly way: "right" | "left" | "round";
}

interface Wired extends Ends {
  readonly region: Box;
  route: Route;
  stale: boolean;
}

const CELL = 200;
const ROW = 2 ** 20; // cells: more than a sheet has, which ends at 1e6
const MOST_CHANGES = 40; // boxes; of more, each wire is found anew
const LOOK_EVERY = 8; // wires between two looks at the clock

export class Router {
  private boxes: ReadonlyMap<string, Box> = new Map();
  private wires = new Map<string, Wired>();
  private stale: Wired[] = [];
  private grid = new Map<number, Box[]>();

  /** Takes in what is on the sheet, by id. */
  update(boxes: ReadonlyMap<string, Box>, wires: readonly Ends[]): void {
    const changed = this.changes(boxes);
    if (changed.length > 0) this.fill(boxes);
    this.boxes = boxes;
    const all = changed.length > MOST_CHANGES;
    const next = new Map<string, Wired>();
    for (const wire of wires) {
      const was = this.wires.get(wire.id);
      if (was === undefined || was.way !== wire.way || !same(was.from, wire.from) || !same(was.to, wire.to)) {
        // What turns round has one way to go.
        next.set(wire.id, { ...wire, region: around(wire), route: {}, stale: wire.way !== "round" });
      } else {
        if (was.way !== "round" && !was.stale && (all || changed.some((box) => touch(box, was.region))))
          was.stale = true;
        next.set(wire.id, was);
      }
    }
    this.wires = next;
    this.stale = [...next.values()].filter((wire) => wire.stale);
  }

  /** Finds bends for as long as `milliseconds`; answers whether some are left to find. */
  work(milliseconds: number): boolean {
    const until = performance.now() + milliseconds;
    for (let n = 1; this.stale.length > 0; n++) {
      const wire = this.stale.pop()!;
      wire.route = bend(wire, this.near(wire.region));
      wire.stale = false;
      if (n % LOOK_EVERY === 0 && performance.now() > until) break;
    }
    return this.stale.length > 0;
  }

  route(id: string): Route {
    return this.wires.get(id)?.route ?? {};
  }

  /** The boxes that came, went or moved: where they were and where they are. */
  private changes(boxes: ReadonlyMap<string, Box>): Box[] {
    const found: Box[] = [];
    for (const [id, box] of boxes) {
      const was = this.boxes.get(id);
      if (was !== undefined && alike(was, box)) continue;
      found.push(box);
      if (was !== undefined) found.push(was);
    }
    for (const [id, was] of this.boxes) if (!boxes.has(id)) found.push(was);
    return found;
  }

  private fill(boxes: ReadonlyMap<string, Box>): void {
    this.grid = new Map();
    for (const box of boxes.values()) {
      for (const cell of cells(box)) {
        const there = this.grid.get(cell);
        if (there === undefined) this.grid.set(cell, [box]);
        else there.push(box);
      }
    }
  }

  private near(around: Box): Box[] {
    if ((around.width * around.height) / CELL ** 2 > this.boxes.size) return [...this.boxes.values()];
    const found = new Set<Box>();
    for (const cell of cells(around)) for (const box of this.grid.get(cell) ?? []) found.add(box);
    return [...found];
  }
}

/** What goes to the left is found as its mirror image, which goes to the right. */
function around({ from, to, way }: Ends): Box {
  return way === "left" ? mirrored(region(turned(from), turned(to))) : region(from, to);
}

function bend({ from, to, way }: Ends, boxes: readonly Box[]): Route {
  if (way === "right") return routed(from, to, boxes);
  const { x, y } = routed(turned(from), turned(to), boxes.map(mirrored));
  return { ...(x === undefined ? {} : { x: -x }), ...(y === undefined ? {} : { y }) };
}

function turned([x, y]: Point): Point {
  return [-x, y];
}

function mirrored(box: Box): Box {
  return { ...box, x: -box.x - box.width };
}

/** The numbers of the cells that a box is in. */
function* cells(box: Box): Generator<number> {
  const last = [Math.floor((box.x + box.width) / CELL), Math.floor((box.y + box.height) / CELL)] as const;
  for (let x = Math.floor(box.x / CELL); x <= last[0]; x++) {
    for (let y = Math.floor(box.y / CELL); y <= last[1]; y++) yield x * ROW + y;
  }
}

function same(a: Point, b: Point): boolean {
  return a[0] === b[0] && a[1] === b[1];
}

function alike(a: Box, b: Box): boolean {
  return a.x === b.x && a.y === b.y && a.width === b.width && a.height === b.height;
}
