// The keys of the sheet. All that a mouse does can be done with them; the dialog of `?` lists them.
import { act, described } from "../actions.svelte";
import { toast } from "../../../state/toasts.svelte";
import { editor } from "../editor.svelte";
import { looseEnd } from "../insert.svelte";
import { next, towards, type Direction } from "./neighbours";
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
  ["O", "open the selected sub-diagram"],
  ["U", "go up to the diagram around it"],
  ["S", "show the selected block's outputs on the scope, or hide them"],
  ["Del", "delete what is selected"],
  ["Ctrl + A", "select all blocks"],
  ["Ctrl + C, X, V, D", "copy, cut, paste, duplicate"],
  ["Ctrl + Z, Ctrl + Y", "undo, redo"],
  ["Ctrl + G", "group into a sub-diagram"],
  ["Ctrl + I", "flip what is selected: inputs to the other side"],
  ["M", "align what is selected, or space it evenly"],
  ["Ctrl + S, Ctrl + O", "save, open"],
  ["Ctrl + B", "flash: what would change is shown first"],
  ["L", "lay out automatically"],
  ["F", "show the whole sheet"],
  ["Esc", "select nothing; from all beside the sheet: back to the sheet"],
  ["?", "show these keys"],
];

const NOT_COMMENTED = [
  "A block is not commented out: what reads it would have no source",
  "info",
  "delete it (Del); Ctrl+Z brings it back",
] as const;
const STEP = 10;
const LONG_STEP = 50;
const ARROWS: Readonly<Record<Direction, readonly [number, number]>> = {
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, -1],
  ArrowDown: [0, 1],
};

function go(to: SheetNode | undefined): void {
  if (to === undefined) return editor.say("no block there");
  editor.select([to.id]);
  act.wanted = to.id;
  editor.say(described(to.id));
}

/** Handles a key on the sheet; what it takes goes no further. */
export function keyOnSheet(event: KeyboardEvent, nodes: readonly SheetNode[]): void {
  const onWire = [...editor.selected].some((id) => id.startsWith("w:"));
  const from = nodes.find((node) => editor.selected.has(node.id) || (onWire && node.id === act.hub));
  const control = event.ctrlKey || event.metaKey;
  const done = control ? withControl(event, nodes, from) : plain(event, nodes, from);
  if (done) {
    event.preventDefault();
    event.stopPropagation();
  }
}

function withControl(event: KeyboardEvent, nodes: readonly SheetNode[], from: SheetNode | undefined): boolean {
  if (event.key in ARROWS) {
    go(from === undefined ? next(nodes, undefined, 1) : towards(nodes, from, event.key as Direction));
    return true;
  }
  if (event.shiftKey) return withShift(event.key.toLowerCase());
  switch (event.key.toLowerCase()) {
    case "a":
      editor.select(nodes.filter((node) => node.id.startsWith("p:")).map((node) => node.id));
      editor.say(`${editor.parts.length} blocks are selected`);
      return true;
    case "c":
      act.copy();
      return true;
    case "x":
      act.cut();
      return true;
    case "v":
      void act.paste();
      return true;
    case "d":
      void act.duplicate();
      return true;
    case "g":
      act.group();
      return true;
    case "i":
      act.flip();
      return true;
  }
  return false; // undo, redo and save are the page's, wherever the focus is
}

/** What Simulink does with Ctrl and Shift; all else is the browser's. */
function withShift(key: string): boolean {
  if (key === "a") void act.arrange();
  else if (key === "x" || key === "y") toast(...NOT_COMMENTED);
  else return false;
  return true;
}

function plain(event: KeyboardEvent, nodes: readonly SheetNode[], from: SheetNode | undefined): boolean {
  if (event.key in ARROWS) {
    const [x, y] = ARROWS[event.key as Direction];
    const by = event.shiftKey ? LONG_STEP : STEP;
    act.nudge(x * by, y * by);
    return true;
  }
  switch (event.key) {
    case "a":
    case "/":
      act.focusPalette();
      return true;
    case "n":
      go(next(nodes, from, 1));
      return true;
    case "p":
      go(next(nodes, from, -1));
      return true;
    case "w":
      act.nextWire();
      return true;
    case "c":
      act.dialog = "connect";
      return true;
    case "i":
      act.inserting = looseEnd(act.middle());
      return true;
    case "Enter":
      act.focusPanel();
      return true;
    case "F2":
      act.focusName();
      return true;
    case "o":
      if (editor.parts.length === 1) act.openPart(editor.parts[0]!);
      return true;
    case "u":
      editor.leave();
      return true;
    case "s":
      act.scope();
      return true;
    case "Delete":
    case "Backspace":
      act.remove();
      return true;
    case "l":
      void act.arrange();
      return true;
    case "m":
      act.openAlignMenu();
      return true;
    case "f":
      act.shownWhole++;
      return true;
    case "Escape":
      editor.select([]);
      return true;
    case "?":
      act.dialog = "keys";
      return true;
  }
  return false;
}
