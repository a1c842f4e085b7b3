// What a menu, a key or a button does with the open sheet.
import { toastError } from "../../state/toasts.svelte";
import { arranged } from "./canvas/arrange";
import { partPlaces } from "./canvas/flow";
import { partSize } from "./canvas/symbol";
import { editor, EMPTY, inputId, outputId, partId } from "./editor.svelte";
import { copyText, paste } from "./model/clipboard";
import { findPart, type Point } from "./model/diagram";
import {
  addInput,
  addOutput,
  addParam,
  addPart,
  disconnect,
  freeName,
  moveParts,
  newPart,
  removeInput,
  removeOutput,
  removeParts,
} from "./model/edits";
import { grouped } from "./model/grouping";
import { real, type JsonObject } from "./model/json_text";
import { tops } from "./model/shapes";
import { scopes } from "./simulate/scopes.svelte";

export type DialogName = "" | "open" | "connect" | "keys" | "flash" | "px4" | "save";

/** What the parts of the page ask of one another. */
class Acts {
  /** The dialog that is open. */
  dialog = $state<DialogName>("");
  /** Bumped to show the whole sheet. */
  shownWhole = $state(0);
  /** What is to be brought into view. */
  wanted = $state("");
  middle: () => Point = () => [160, 80];
  focusSheet: () => void = () => undefined;
  focusPalette: () => void = () => undefined;
  focusPanel: () => void = () => undefined;
  save: () => void = () => undefined;
  private copied = "";

  openPart(name: string): void {
    if (findPart(editor.here, name)?.item.is === "diagram") editor.enter([...editor.path, name]);
    else this.focusPanel();
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
    this.put(outside.includes("twodof/parts") ? outside : this.copied);
  }

  duplicate(): void {
    if (editor.parts.length > 0) this.put(copyText(editor.here, new Set(editor.parts)));
  }

  private put(text: string): void {
    if (text === "") return editor.say("nothing was copied");
    try {
      const { diagram, names } = paste(editor.here, text);
      editor.apply(`paste ${names.length} ${names.length === 1 ? "block" : "blocks"}`, () => diagram);
      editor.select(names.map(partId));
    } catch (failure) {
      toastError(failure);
    }
  }

  remove(): void {
    const ids = [...editor.selected];
    if (ids.length === 0) return editor.say("nothing is selected");
    const of = (kind: string): string[] => ids.filter((id) => id.startsWith(kind)).map((id) => id.slice(2));
    const what = ids.length === 1 ? (of("p:")[0] ?? of("w:")[0] ?? ids[0]!.slice(2)) : `${ids.length} things`;
    editor.apply(`delete ${what}`, (d) => {
      let after = removeParts(disconnect(d, new Set(of("w:"))), new Set(of("p:")));
      for (const name of of("i:")) after = removeInput(after, name);
      for (const name of of("o:")) after = removeOutput(after, name);
      return after;
    });
    editor.select([]);
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

  async arrange(): Promise<void> {
    const before = editor.here;
    try {
      const places = await arranged(before, editor.shapes);
      if (editor.here !== before) return; // it was edited meanwhile
      editor.apply("arrange", (d) => moveParts(d, places));
      this.shownWhole++;
    } catch (failure) {
      toastError(failure);
    }
  }

  /** Puts what is selected on the scope, or takes it off: a wire, or a block's first output. */
  scope(): void {
    const [id = ""] = editor.selected;
    const name = id.slice(2);
    if (id === "") return editor.say("select a block or a wire to show");
    const outputs = editor.here.outputs.find(([one]) => one === name)?.[1];
    const wired = editor.here.connections.find(([, to]) => to === name)?.[0];
    const source = id.startsWith("w:") ? (wired ?? outputs) : id.startsWith("o:") ? outputs : name;
    const part = findPart(editor.here, name);
    const port = id.startsWith("p:") && part !== undefined ? tops(editor.shapes.of(part.item).outputs)[0] : undefined;
    if (id.startsWith("p:") && port === undefined) return editor.say(`${name} has no output`);
    if (source === undefined || source === null) return editor.say("nothing flows there");
    scopes.toggle(part !== undefined && port !== undefined ? `${name}.${port}` : source);
  }

  /** Moves what is selected by whole steps. */
  nudge(dx: number, dy: number): void {
    const chosen = new Set(editor.parts);
    if (chosen.size === 0) return editor.say("select a block to move");
    const places = new Map<string, Point>();
    for (const part of editor.here.parts) {
      const [x, y] = part.position?.map((one) => one.value) ?? [0, 0];
      if (chosen.has(part.name)) places.set(part.name, [(x ?? 0) + dx, (y ?? 0) + dy]);
    }
    editor.apply("move", (d) => moveParts(d, places), `nudge ${[...chosen].join()}`);
    const first = places.get(editor.parts[0]!)!;
    editor.say(`${editor.parts[0]} at ${first[0]}, ${first[1]}`);
  }
}

export const act = new Acts();

/** Adds a block, "diagram" (an empty sub-diagram), "input", "output" or "parameter"; selects it. */
export function add(type: string, at?: Point): void {
  const place = free(at ?? act.middle());
  if (type === "input" || type === "output" || type === "parameter") return addBorder(type);
  const entry = editor.catalogue?.blocks.find((one) => one.type === type);
  if (type !== "diagram" && entry === undefined) return;
  const wanted = type === "diagram" ? "sub" : type.replace(/^models\./, "").toLowerCase();
  const name = freeName(editor.here, wanted);
  const item =
    entry === undefined
      ? { ...EMPTY, name, inputs: [{ name: "u" }], outputs: [["y", "u"] as const] }
      : ({ is: "block", type, json: { type, config: entry.config } } as const);
  editor.apply(`add ${name}`, (d) => addPart(d, newPart(d, name, item, place)));
  editor.select([partId(name)]);
  act.wanted = partId(name);
}

function addBorder(what: "input" | "output" | "parameter"): void {
  const stem = { input: "u", output: "y", parameter: "k" }[what];
  const outputs = new Set(editor.here.outputs.map(([name]) => name));
  const name = freeName(editor.here, stem, what === "output" ? outputs : new Set());
  if (what === "output") editor.apply(`add output ${name}`, (d) => addOutput(d, name));
  else {
    const declared: JsonObject = what === "input" ? { name } : { name, value: real(1) };
    editor.apply(`add ${what} ${name}`, (d) => (what === "input" ? addInput(d, declared) : addParam(d, declared)));
  }
  editor.select(what === "parameter" ? [] : [what === "input" ? inputId(name) : outputId(name)]);
}

/** The place nearest right of and below `at` where a block of the usual size covers no other, nor its name. */
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

/** What a screen reader is told of a node: what it is, and what its ports are wired to. */
export function described(id: string): string {
  const name = id.slice(2);
  const d = editor.here;
  if (id.startsWith("i:")) {
    const to = d.connections.filter(([source]) => source.split(".")[0] === name).map(([, end]) => end);
    return `input ${name}, ${to.length === 0 ? "goes nowhere" : `to ${to.join(", ")}`}`;
  }
  if (id.startsWith("o:")) {
    return `output ${name}, ${d.outputs.find(([one]) => one === name)?.[1] ?? "not connected"}`;
  }
  const part = findPart(d, name);
  if (part === undefined) return name;
  const shape = editor.shapes.of(part.item);
  const kind = part.item.is === "diagram" ? "sub-diagram" : part.item.type.replace(/_/g, " ");
  const inputs = [...new Set(shape.inputs.map((port) => port.name.split(".")[0]!))].map((port) => {
    const source = d.connections.find(([, to]) => to === `${name}.${port}`)?.[0];
    return `${port} ${source === undefined ? "not connected" : `from ${source}`}`;
  });
  const readers = d.connections.filter(([source]) => source.split(".")[0] === name).map(([, to]) => to);
  const outputs = d.outputs.filter(([, source]) => source?.split(".")[0] === name).map(([one]) => `output ${one}`);
  const to = [...readers, ...outputs];
  return [`${name}, ${kind}`, ...inputs, to.length === 0 ? "read by nobody" : `to ${to.join(", ")}`].join("; ");
}
