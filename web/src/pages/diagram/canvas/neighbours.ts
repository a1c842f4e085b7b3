// Walking over a sheet by keys: the nearest node in a direction, and the next one in reading order.
import type { SheetNode } from "./flow";

export type Direction = "ArrowLeft" | "ArrowRight" | "ArrowUp" | "ArrowDown";

function middle(node: SheetNode): [number, number] {
  return [node.position.x + (node.width ?? 0) / 2, node.position.y + (node.height ?? 0) / 2];
}

/** The node that an arrow leads to from `from`: near, and more ahead than aside. */
export function towards(nodes: readonly SheetNode[], from: SheetNode, direction: Direction): SheetNode | undefined {
  const [x, y] = middle(from);
  const sign = direction === "ArrowLeft" || direction === "ArrowUp" ? -1 : 1;
  const across = direction === "ArrowLeft" || direction === "ArrowRight";
  let best: SheetNode | undefined;
  let least = Infinity;
  for (const node of nodes) {
    if (node.id === from.id) continue;
    const [a, b] = middle(node);
    const ahead = sign * (across ? a - x : b - y);
    const aside = Math.abs(across ? b - y : a - x);
    if (ahead <= 1) continue;
    const distance = ahead + 2 * aside;
    if (distance < least) [best, least] = [node, distance];
  }
  return best;
}

/** Inputs stand with their right edges in a line. */
function column(node: SheetNode): number {
  return node.position.x + (node.type === "inlet" ? (node.width ?? 0) : 0);
}

/** The one after (or, with -1, before) `from` as one reads; the first (last) without one. */
export function next(nodes: readonly SheetNode[], from: SheetNode | undefined, step: 1 | -1): SheetNode | undefined {
  const read = [...nodes].sort((a, b) => column(a) - column(b) || a.position.y - b.position.y);
  const at = from === undefined ? (step === 1 ? -1 : read.length) : read.findIndex((node) => node.id === from.id);
  return read[(at + step + read.length) % read.length];
}
