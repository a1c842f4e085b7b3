// The keys of the sheet. All that a mouse does can be done with them; the dialog of `?` lists them.
import { act, described } from "../actions.svelte";
import { editor } from "../editor.svelte";
import { folds } from "../folds.svelte";
import { looseEnd } from "../insert.svelte";
import { partId } from "../model/diagram";
import type { SheetNode } from "./flow";

export const KEYS: readonly (readonly [keys: string, does: string])[] = [
  ["A or /", "add a block: search the palette"],
  ["I", "insert a block here: into the selected wire, or behind the selected block"],
  ["N, P", "go to the next or previous block, as one reads"],
  ["W", "go to the next wire of the block: Del deletes it"],
  ["Ctrl + arrows", "go to the nearest block in that direction"],
  ["Arrows", "move what is selected by 10; with Shift by 50"],
  ["C", "connect the selected block"],
  ["Ctrl + click", "connect what is selected to the block that is clicked"],
  ["Enter", "set the arguments of the selected block"],
  ["F2", "rename it"],
  ["O", "open the selected sub-diagram, or a state machine as a chart"],
  ["U", "go up to the diagram around it"],
  ["S", "show the selected block's outputs on the scope, or hide them"],
  ["Del", "delete what is selected"],
  ["Ctrl + A", "select all blocks"],
  ["Ctrl + C, X, V, D", "copy, cut, paste, duplicate"],
  ["Ctrl + Z, Ctrl + Y", "undo, redo"],
  ["Ctrl + G", "group into a sub-diagram; with Shift: put its blocks in its place"],
  ["Ctrl + Shift + X", "comment out: the outputs of what is selected are 0; again: use it"],
  ["Ctrl + Shift + Y", "comment through: its outputs are its inputs; again: use it"],
  ["Ctrl + I", "flip what is selected: inputs to the other side"],
  ["M", "align what is selected, or space it evenly"],
  ["Ctrl + S, Ctrl + O", "save, open"],
  ["Ctrl + B", "flash: what would change is shown first"],
  ["L", "lay out automatically"],
  ["F", "show the whole sheet"],
  ["H", "fold the panels around the sheet, or show them"],
  ["Esc", "select nothing; from all beside the sheet: back to the sheet"],
  ["?", "show these keys"],
];

const STEP = 10;
const LONG_STEP = 50;
type Direction = "ArrowLeft" | "ArrowRight" | "ArrowUp" | "ArrowDown";
const ARROWS: Readonly<Record<Direction, readonly [number, number]>> = {
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, -1],
  ArrowDown: [0, 1],
};

function middle(node: SheetNode): [number, number] {
  return [node.position.x + (node.width ?? 0) / 2, node.position.y + (node.height ?? 0) / 2];
}

function towards(nodes: readonly SheetNode[], from: SheetNode, direction: Direction): SheetNode | undefined {
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

function column(node: SheetNode): number {
  return node.position.x + (node.type === "inlet" ? (node.width ?? 0) : 0);
}

/** Return the next or previous node in reading order. */
function next(nodes: readonly SheetNode[], from: SheetNode | undefined, step: 1 | -1): SheetNode | undefined {
  const read = [...nodes].sort((a, b) => column(a) - column(b) || a.position.y - b.position.y);
  const at = from === undefined ? (step === 1 ? -1 : read.length) : read.findIndex((node) => node.id === from.id);
  return read[(at + step + read.length) % read.length];
}

function go(to: SheetNode | undefined): void {
  if (to === undefined) return editor.say("no block there");
  editor.select([to.id]);
  act.wanted = to.id;
  editor.say(described(to.id));
}

/** Handle a key on the sheet. A key of the sheet goes no further. */
export function keyOnSheet(event: KeyboardEvent, nodes: readonly SheetNode[]): void {
  const onWire = [...editor.selected].some((id) => id.startsWith("w:"));
  const from = nodes.find((node) => editor.selected.has(node.id) || (onWire && node.id === act.hub));
  const action = actionOf(event, nodes, from);
  if (action === undefined) return;
  void action();
  event.preventDefault();
  event.stopPropagation();
}

/** Keys with Ctrl or Cmd. Undo, redo and save are the page's, wherever the focus is. */
const WITH_CONTROL: Readonly<Record<string, () => unknown>> = {
  a: selectAll,
  c: () => act.copy(),
  x: () => act.cut(),
  v: () => act.paste(),
  d: () => act.duplicate(),
  g: () => act.group(),
  i: () => act.flip(),
};
/** Keys of Simulink with Ctrl and Shift. */
const WITH_SHIFT: Readonly<Record<string, () => unknown>> = {
  a: () => act.arrange(),
  g: () => act.ungroup(),
  x: () => act.comment("out"),
  y: () => act.comment("through"),
};
const PLAIN: Readonly<Record<string, () => unknown>> = {
  a: () => act.focusPalette(),
  "/": () => act.focusPalette(),
  w: () => act.nextWire(),
  c: () => (act.dialog = "connect"),
  i: () => (act.inserting = looseEnd(act.middle())),
  Enter: () => act.toPanel("focusPanel"),
  F2: () => act.toPanel("focusName"),
  o: () => editor.parts.length === 1 && act.openPart(editor.parts[0]!),
  u: () => editor.leave(),
  s: () => act.scope(),
  Delete: () => act.remove(),
  Backspace: () => act.remove(),
  l: () => act.arrange(),
  m: () => act.openAlignMenu(),
  f: () => act.shownWhole++,
  h: () => folds.toggleAll(),
  Escape: () => editor.select([]),
  "?": () => (act.dialog = "keys"),
};

function selectAll(): void {
  editor.select(editor.here.parts.map((part) => partId(part.name)));
  editor.say(`${editor.parts.length} blocks are selected`);
}

/** Find the action of a key; undefined for a key that is not the sheet's. */
function actionOf(
  event: KeyboardEvent,
  nodes: readonly SheetNode[],
  from: SheetNode | undefined,
): (() => unknown) | undefined {
  const control = event.ctrlKey || event.metaKey;
  const key = event.key.toLowerCase();
  if (event.key in ARROWS) {
    const direction = event.key as Direction;
    if (control) return () => go(from === undefined ? next(nodes, undefined, 1) : towards(nodes, from, direction));
    const by = event.shiftKey ? LONG_STEP : STEP;
    return () => act.nudge(by * ARROWS[direction][0], by * ARROWS[direction][1]);
  }
  if (control) return (event.shiftKey ? WITH_SHIFT : WITH_CONTROL)[key];
  if (event.key === "n" || event.key === "p") return () => go(next(nodes, from, event.key === "n" ? 1 : -1));
  return PLAIN[event.key];
}
