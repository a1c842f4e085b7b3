// What a menu, a key or a button does with the open sheet.
import { tick } from "svelte";
import { toast, tried } from "../../state/toasts.svelte";
import { arranged } from "./canvas/arrange";
import { boxesOn, partPlaces, placesOn } from "./canvas/places";
import { partSize } from "./canvas/symbol";
import { editor } from "./editor.svelte";
import { ALIGNMENTS, aligned, leastFor, type Alignment } from "./model/align";
import { copyText, paste } from "./model/clipboard";
import { EMPTY, findPart, inputId, outputId, partId, sourceOf, wireId, type Part, type Point } from "./model/diagram";
import * as edits from "./model/edits";
import { MACHINE, NEW_MACHINE, NEW_STATE, opens, STATE } from "./model/chart";
import { commented, commentToggled, type Comment } from "./model/comment";
import { grouped, ungrouped } from "./model/grouping";
import { real } from "./model/json_text";
import { SUBTRACT } from "./model/search";
import { tops } from "./model/shapes";
import { joined, wiresAt } from "./model/wiring";
import { folds } from "./folds.svelte";
import type { Loose } from "./insert.svelte";
import { scopes } from "./simulate/scopes.svelte";

export type DialogName = "" | "open" | "connect" | "keys" | "flash" | "px4" | "save" | "simulink";

const MANY = 50; // blocks of a paste

/** Actions that the parts of the page ask of one another. */
class Acts {
  dialog = $state<DialogName>("");
  /** Counter; an increment shows the whole sheet. */
  shownWhole = $state(0);
  /** Id to scroll into view. */
  wanted = $state("");
  inserting = $state.raw<Loose | undefined>(undefined);
  middle: () => Point = () => [160, 80];
  focusSheet: () => void = () => undefined;
  focusPalette: () => void = () => undefined;
  focusPanel: () => void = () => undefined;
  focusName: () => void = () => undefined;
  /** Tab of the panel beside the sheet. */
  tab = $state<"block" | "problems" | "margins" | "code">("block");
  openAlignMenu: () => void = () => undefined;
  save: () => void = () => undefined;
  begin: () => void = () => undefined;
  /** Node whose wires are walked by W. */
  hub = "";
  private copied = "";

  openPart(name: string): void {
    const part = findPart(editor.here, name);
    if (part && opens(part)) editor.enter([...editor.path, name]);
    else void this.toPanel("focusPanel");
  }

  /** Show the properties of what is selected, and move the focus there. */
  async toPanel(field: "focusPanel" | "focusName"): Promise<void> {
    folds.fold("side", false);
    this.tab = "block";
    await tick();
    this[field]();
  }

  copy(): void {
    if (editor.parts.length === 0) return editor.say("select blocks to copy");
    this.copied = copyText(editor.here, new Set(editor.parts));
    // The system's clipboard serves other pages; where it is closed to us, our own does.
    void navigator.clipboard?.writeText(this.copied).catch(() => undefined);
    editor.say(`${editor.parts.length} copied`);
  }

  cut(): void {
    this.copy();
    this.remove();
  }

  async paste(): Promise<void> {
    const outside = await (navigator.clipboard?.readText() ?? Promise.resolve("")).catch(() => "");
    await this.put(outside.includes("twodof/parts") ? outside : this.copied);
  }

  async duplicate(): Promise<void> {
    if (editor.parts.length > 0) await this.put(copyText(editor.here, new Set(editor.parts)));
  }

  private async put(text: string): Promise<void> {
    if (text === "") return editor.say("nothing was copied");
    await tried(async () => {
      const before = editor.here;
      const read = paste(before, text);
      // Reading much and showing it are two tasks, so that neither holds the page up.
      if (read.names.length > MANY) await new Promise((next) => setTimeout(next));
      const { diagram, names } = editor.here === before ? read : paste(editor.here, text);
      editor.apply(`paste ${names.length} ${names.length === 1 ? "block" : "blocks"}`, () => diagram);
      editor.select(names.map(partId));
    });
  }

  remove(): void {
    const ids = [...editor.selected];
    if (ids.length === 0) return editor.say("nothing is selected");
    const of = (kind: string): string[] => ids.filter((id) => id.startsWith(kind)).map((id) => id.slice(2));
    const what =
      ids.length === 1
        ? (of("p:")[0] ?? of("w:").map((to) => `the wire to ${to}`)[0] ?? ids[0]!.slice(2))
        : `${ids.length} things`;
    const [wire] = of("w:");
    const walked = ids.length === 1 && wire !== undefined && wiresAt(editor.here, this.hub).includes(wire);
    editor.apply(`delete ${what}`, (d) => {
      let after = edits.removeParts(edits.disconnect(d, new Set(of("w:"))), new Set(of("p:")));
      for (const name of of("i:")) after = edits.removeInput(after, name);
      for (const name of of("o:")) after = edits.removeOutput(after, name);
      return after;
    });
    editor.select(walked ? [this.hub] : []); // one goes on from where the wire was found
  }

  group(): void {
    if (editor.parts.length === 0) return editor.say("select the blocks of the sub-diagram");
    let name = "";
    editor.apply(`group ${editor.parts.length} blocks`, (d) => {
      const made = grouped(d, new Set(editor.parts), editor.shapes);
      name = made.name;
      return made.diagram;
    });
    editor.select([partId(name)]);
  }

  ungroup(): void {
    const [name = ""] = editor.parts;
    const part = findPart(editor.here, name);
    const comment = part && commented(part);
    if (comment) return this.comment(comment.how);
    if (editor.parts.length !== 1) return editor.say("select one sub-diagram");
    let names: readonly string[] = [];
    const refused = editor.apply(`ungroup ${name}`, (d) => {
      const made = ungrouped(d, name, part?.item.is === "diagram" ? partPlaces(part.item, editor.shapes) : []);
      names = made.names;
      return made.diagram;
    });
    if (refused !== "") toast(refused, "info");
    else editor.select(names.map(partId));
  }

  comment(how: Comment): void {
    const names = editor.parts;
    if (names.length === 0) return editor.say("select the blocks to comment");
    const refused = editor.apply(`comment ${how} ${names.join(", ")}`, (d) =>
      commentToggled(d, new Set(names), how, editor.shapes),
    );
    if (refused !== "") toast(refused, "info");
  }

  async arrange(): Promise<void> {
    const before = editor.here;
    await tried(async () => {
      const places = await arranged(before, editor.shapes);
      if (editor.here !== before) return; // it was edited meanwhile
      editor.apply("arrange", (d) => edits.freeBorder(edits.moveParts(d, places)));
      this.shownWhole++;
    });
  }

  /** Toggle the scope of the selected wire, or of a block's first output. */
  scope(): void {
    const [id = ""] = editor.selected;
    const name = id.slice(2);
    if (id === "" || editor.here.chart) return editor.say("select a block or a wire of a diagram to show");
    const source = /^[wo]:/.test(id) ? sourceOf(editor.here, name) : name;
    const part = findPart(editor.here, name);
    const port = id.startsWith("p:") && part !== undefined ? tops(editor.shapes.of(part.item).outputs)[0] : undefined;
    if (id.startsWith("p:") && port === undefined) return editor.say(`${name} has no output`);
    if (source === undefined) return editor.say("this wire carries no signal");
    scopes.toggle(part !== undefined && port !== undefined ? `${name}.${port}` : source);
  }

  /** Wire nodes, the topmost first, to the clicked one, and select that. */
  join(ids: Iterable<string>, to: string): void {
    const at = placesOn(editor.here, editor.shapes);
    const place = (id: string): Point => at.get(id) ?? [0, 0];
    const from = [...ids]
      .filter((id) => id !== to && at.has(id))
      .sort((a, b) => place(a)[1] - place(b)[1] || place(a)[0] - place(b)[0]);
    const names = from.map((id) => id.slice(2)).join(", ");
    const refused = editor.apply(`connect ${names} to ${to.slice(2)}`, (d) => joined(d, editor.shapes, from, to));
    if (refused !== "") toast(refused, "info");
    editor.select([to]);
  }

  flip(): void {
    const names = editor.parts;
    if (names.length === 0) return editor.say("select a block to flip");
    editor.apply(`flip ${names.length === 1 ? names[0] : `${names.length} blocks`}`, (d) =>
      edits.flipParts(d, new Set(names)),
    );
  }

  align(how: Alignment): void {
    const all = boxesOn(editor.here, editor.shapes);
    const chosen = [...editor.selected].flatMap((id) => (all.has(id) ? [[id, all.get(id)!] as const] : []));
    if (chosen.length < leastFor(how)) return editor.say("select more blocks");
    editor.apply(`align: ${ALIGNMENTS[how].toLowerCase()}`, (d) => edits.moveThings(d, aligned(new Map(chosen), how)));
  }

  nextWire(): void {
    const [id = ""] = editor.selected;
    const wire = id.startsWith("w:") ? id.slice(2) : "";
    if (wire === "") this.hub = id;
    const wires = wiresAt(editor.here, this.hub);
    const to = wires[(wires.indexOf(wire) + 1) % wires.length];
    if (to === undefined) return editor.say(id === "" ? "select a block to walk its wires" : "no wire there");
    editor.select([wireId(to)]);
    editor.say(`wire from ${sourceOf(editor.here, to)} to ${to}`);
  }

  nudge(dx: number, dy: number): void {
    const chosen = [...editor.selected].filter((id) => !id.startsWith("w:"));
    if (chosen.length === 0) return editor.say("select a block to move");
    const at = placesOn(editor.here, editor.shapes);
    const places = new Map<string, Point>();
    for (const id of chosen) {
      const [x, y] = at.get(id) ?? [0, 0];
      places.set(id, [x + dx, y + dy]);
    }
    editor.apply("move", (d) => edits.moveThings(d, places), `nudge ${chosen.join()}`);
    const first = places.get(chosen[0]!)!;
    editor.say(`${chosen[0]!.slice(2)} at ${first[0]}, ${first[1]}`);
  }
}

export const act = new Acts();

/** Add a block, "diagram", "input", "output" or "parameter", and select it. */
export function add(type: string, at?: Point): void {
  if (type === "input" || type === "output" || type === "parameter" || type === "variable") return addBorder(type);
  const part = made(type, at ?? act.middle());
  if (part === undefined) return;
  editor.apply(`add ${part.name}`, (d) => edits.addPart(d, part));
  editor.select([partId(part.name)]);
  act.wanted = partId(part.name);
}

/** Make a part with a free place near `at`; undefined for an unknown type. */
export function made(asked: string, at: Point): Part | undefined {
  const [type, more] = asked === SUBTRACT ? ["sum", { signs: "+-" }] : [asked, {}];
  const entry = editor.catalogue?.blocks.find((one) => one.type === type);
  const own = { [MACHINE]: NEW_MACHINE, [STATE]: NEW_STATE }[type];
  if (type !== "diagram" && own === undefined && entry === undefined) return undefined;
  const name = edits.freeName(
    editor.here,
    { diagram: "sub", [MACHINE]: "chart" }[type] ?? type.replace(/^models\./, "").toLowerCase(),
  );
  const item =
    own ??
    (entry === undefined
      ? { ...EMPTY, name, inputs: [{ name: "u" }], outputs: [["y", "u"] as const] }
      : ({ is: "block", type, json: { type, config: { ...entry.config, ...more } } } as const));
  return edits.newPart(editor.here, name, item, free(at));
}

/** Add an input, output or parameter; an input is wired to the destination `to`, an output to the source `from`. */
export function addBorder(
  what: "input" | "output" | "parameter" | "variable",
  verb = "add",
  from: string | null = null,
  to: string | null = null,
): void {
  const stem = { input: "u", output: "y", parameter: "k", variable: "n" }[what];
  const outputs = new Set(editor.here.outputs.map(([name]) => name));
  const name = edits.freeName(editor.here, stem, what === "output" ? outputs : []);
  editor.apply(`${verb} ${what} ${name}`, (d) => {
    if (what === "output") return edits.addOutput(d, name, from);
    if (what === "variable") return edits.addVariable(d, name);
    if (what === "parameter") return edits.addParam(d, { name, value: real(1) });
    const after = edits.addInput(d, { name });
    return to === null ? after : edits.connect(after, name, to);
  });
  editor.select(editor.here.chart || what === "parameter" ? [] : [what === "input" ? inputId(name) : outputId(name)]);
}

/** Return the nearest free place right of and below `at`. */
function free([x, y]: Point): Point {
  const places = partPlaces(editor.here, editor.shapes);
  const boxes = editor.here.parts.map((part, i) => [places[i]!, partSize(part, editor.shapes.of(part.item))] as const);
  const [left, top] = [10 * Math.round(x / 10), 10 * Math.round(y / 10)];
  const covers = (a: Point): boolean =>
    boxes.some(
      ([at, size]) =>
        a[0] < at[0] + size.width + 20 && at[0] < a[0] + 100 && a[1] < at[1] + size.height + 20 && at[1] < a[1] + 80,
    );
  for (let ring = 0; ring < 40; ring++) {
    for (let i = 0; i <= ring; i++) {
      const tried: Point[] = [
        [left + 40 * ring, top + 40 * i],
        [left + 40 * i, top + 40 * ring],
      ];
      for (const place of tried) if (!covers(place)) return place;
    }
  }
  return [left, top];
}

/** Describe a node and its wires for a screen reader. */
export function described(id: string): string {
  const name = id.slice(2);
  const d = editor.here;
  if (id.startsWith("i:")) {
    const to = d.connections.filter(([source]) => source.split(".")[0] === name).map(([, end]) => end);
    return `input ${name}, ${to.length === 0 ? "not connected" : `to ${to.join(", ")}`}`;
  }
  if (id.startsWith("o:")) {
    return `output ${name}, ${sourceOf(d, name) ?? "not connected"}`;
  }
  const part = findPart(d, name);
  if (part === undefined) return name;
  const shape = editor.shapes.of(part.item);
  const kind = part.item.is === "diagram" ? "sub-diagram" : part.item.type.replace(/_/g, " ");
  const inputs = tops(shape.inputs).map((port) => {
    const source = sourceOf(d, `${name}.${port}`);
    return `${port} ${source === undefined ? "not connected" : `from ${source}`}`;
  });
  const readers = d.connections.filter(([source]) => source.split(".")[0] === name).map(([, to]) => to);
  const outputs = d.outputs.filter(([, source]) => source?.split(".")[0] === name).map(([one]) => `output ${one}`);
  const to = [...readers, ...outputs];
  return [`${name}, ${kind}`, ...inputs, to.length === 0 ? "not read" : `to ${to.join(", ")}`].join("; ");
}
