// Blocks in a line, or with even gaps between them.
import type { Box } from "../canvas/route";
import type { Point } from "./diagram";

type Boxes = ReadonlyMap<string, Box>;

/** Labels in the order of the menu. */
export const ALIGNMENTS = {
  left: "Left edges",
  centre: "Centres, one above the other",
  right: "Right edges",
  top: "Top edges",
  middle: "Middles, side by side",
  bottom: "Bottom edges",
  across: "Even gaps from left to right",
  down: "Even gaps from top to bottom",
} as const;
export type Alignment = keyof typeof ALIGNMENTS;

export function leastFor(how: Alignment): number {
  return how === "across" || how === "down" ? 3 : 2;
}

/** Return aligned places: edges at the outermost box, centres at the middle of all. */
export function aligned(boxes: Boxes, how: Alignment): Map<string, Point> {
  if (how === "across") return spread(boxes, "x", "width");
  if (how === "down") return spread(boxes, "y", "height");
  const all = [...boxes.values()];
  const [left, top] = [Math.min(...all.map((b) => b.x)), Math.min(...all.map((b) => b.y))];
  const [right, bottom] = [Math.max(...all.map((b) => b.x + b.width)), Math.max(...all.map((b) => b.y + b.height))];
  const place: Record<Exclude<Alignment, "across" | "down">, (b: Box) => Point> = {
    left: (b) => [left, b.y],
    centre: (b) => [(left + right - b.width) / 2, b.y],
    right: (b) => [right - b.width, b.y],
    top: (b) => [b.x, top],
    middle: (b) => [b.x, (top + bottom - b.height) / 2],
    bottom: (b) => [b.x, bottom - b.height],
  };
  return new Map([...boxes].map(([id, box]) => [id, place[how](box)]));
}

/** Space boxes evenly between the first and the last. */
function spread(boxes: Boxes, axis: "x" | "y", size: "width" | "height"): Map<string, Point> {
  const row = [...boxes].sort(([, a], [, b]) => a[axis] - b[axis]);
  const [first, last] = [row[0]![1], row.at(-1)![1]];
  const between = row.slice(1, -1).reduce((sum, [, box]) => sum + box[size], 0);
  const gap = (last[axis] - first[axis] - first[size] - between) / (row.length - 1);
  const found = new Map<string, Point>();
  let at = first[axis];
  for (const [id, box] of row) {
    const to = box === last ? last[axis] : Math.round(at);
    found.set(id, axis === "x" ? [to, box.y] : [box.x, to]);
    at += box[size] + gap;
  }
  return found;
}
