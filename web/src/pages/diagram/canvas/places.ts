// Where blocks, inputs and outputs stand on a sheet.
import type { Diagram, Point } from "../model/diagram";
import { findPart, inputId, inputNames, outputId, partId, placeOf, pointOf } from "../model/diagram";
import { moveThings } from "../model/edits";
import type { Shapes } from "../model/shapes";
import type { Box } from "./route";
import { partSize, type Size } from "./symbol";

export const TERMINAL_HEIGHT = 20; // its middle is on the grid, as the ports of blocks are: wires between them are straight
const GAP = 60;
const PITCH = 40; // between two inputs or outputs
const NEAR = 100; // left edges that are nearer cover each other

export function terminalWidth(name: string): number {
  return Math.min(190, Math.max(50, 10 * Math.ceil((name.length * 6.6 + 18) / 10)));
}

export function partPlaces(d: Diagram, shapes: Shapes): Point[] {
  const placed = d.parts.map(placeOf);
  const bottom = Math.max(
    0,
    ...placed.map((at, i) => (at === null ? 0 : at[1] + partSize(d.parts[i]!, shapes.of(d.parts[i]!.item)).height)),
  );
  let free = 0;
  return placed.map((at) => at ?? ([160 * (free % 6), bottom + GAP + 100 * Math.floor(free++ / 6)] as const));
}

/** Return the place of a node that the file gives, or undefined. */
function ownPlace(d: Diagram, id: string): Point | undefined {
  const name = id.slice(2);
  const part = id.startsWith("p:") ? findPart(d, name) : undefined;
  const at = part?.position ?? (id.startsWith("i:") ? d.inputPositions : d.outputPositions)[name];
  return pointOf(at) ?? undefined;
}

/**
 * Keep the nodes that an edit does not move where they were drawn before it. A place that the file would not give is
 * written.
 */
export function staying(before: Diagram, after: Diagram, shapes: Shapes): Diagram {
  if (after.drawn !== before.drawn) return after;
  const free = placesOn({ ...after, drawn: undefined }, shapes);
  const kept = [...placesOn(before, shapes)].filter(([id]) => free.has(id) && ownPlace(after, id) === undefined);
  const moved = kept.filter(([id, at]) => String(at) !== String(free.get(id)));
  return { ...moveThings(after, new Map(moved)), drawn: new Map(kept) };
}

export function placesOn(d: Diagram, shapes: Shapes): Map<string, Point> {
  const places = partPlaces(d, shapes);
  const parts = d.parts.map((part, i) => [partId(part.name), places[i]!] as const);
  return new Map([...parts, ...terminalPlaces(d, shapes, places)]);
}

export function boxesOn(d: Diagram, shapes: Shapes): Map<string, Box> {
  const sizes = new Map(d.parts.map((part) => [partId(part.name), partSize(part, shapes.of(part.item))]));
  const border = (id: string): Size => ({ width: terminalWidth(id.slice(2)), height: TERMINAL_HEIGHT });
  return new Map([...placesOn(d, shapes)].map(([id, [x, y]]) => [id, { x, y, ...(sizes.get(id) ?? border(id)) }]));
}

/**
 * Inputs stand left of all parts, outputs right of them, each at the height of what it is wired to, if there is room; or
 * where they were moved to.
 */
export function terminalPlaces(d: Diagram, shapes: Shapes, places: readonly Point[]): Map<string, Point> {
  const sizes = d.parts.map((part) => partSize(part, shapes.of(part.item)));
  const middle = new Map(d.parts.map((part, i) => [part.name, places[i]![1] + sizes[i]!.height / 2]));
  const left = Math.min(GAP, ...places.map(([x]) => x)) - GAP;
  const right = Math.max(GAP, ...places.map(([x], i) => x + sizes[i]!.width)) + GAP;
  const found = new Map<string, Point>();
  const inputs = inputNames(d).map((name) => {
    const to = d.connections.find(([source]) => source.split(".")[0] === name)?.[1].split(".")[0] ?? "";
    return [inputId(name), middle.get(to)] as const;
  });
  const outputs = d.outputs.map(([name, source]) => [outputId(name), middle.get(source?.split(".")[0] ?? "")] as const);
  for (const [rows, x] of [
    [inputs, left],
    [outputs, right],
  ] as const) {
    for (const [id] of rows) {
      const own = ownPlace(d, id) ?? d.drawn?.get(id);
      if (own !== undefined) found.set(id, own);
    }
    const own = [...found.values()];
    let next = -Infinity;
    const lowest = Math.max(0, ...[...middle.values()]);
    for (const [id, at] of rows.map(([id, y]) => [id, y ?? lowest] as const).sort((a, b) => a[1] - b[1])) {
      if (found.has(id)) continue;
      const edge = x === left ? x - terminalWidth(id.slice(2)) : x;
      let y = Math.max(10 * Math.round((at - TERMINAL_HEIGHT / 2) / 10), next);
      while (own.some((one) => Math.abs(one[0] - edge) < NEAR && Math.abs(one[1] - y) < PITCH)) y += 10;
      found.set(id, [edge, y]);
      next = y + PITCH;
    }
  }
  return found;
}
