// A block put at the loose end of a wire, into a wire, or just somewhere: found by a search where it is to stand.
import { addBorder, made } from "./actions.svelte";
import { placesOn } from "./canvas/places";
import { editor } from "./editor.svelte";
import { MACHINE, STATE } from "./model/chart";
import { findPart, outputId, partId, sourceOf, type Point } from "./model/diagram";
import { addPart, connect } from "./model/edits";
import { SUBTRACT, type Choice } from "./model/search";
import { sourceText, tops } from "./model/shapes";

/** Wire without one end, and the place of the missing block. */
export interface Loose {
  readonly from: string | null;
  readonly to: string | null;
  readonly at: Point;
}

const OWN: readonly Choice[] = [
  { type: "input", name: "Input", group: "sheet", text: "An input of this diagram." },
  { type: "output", name: "Output", group: "sheet", text: "An output of this diagram." },
  { type: "parameter", name: "Parameter", group: "sheet", text: "A parameter of this diagram, to tune blocks by." },
  { type: "diagram", name: "Sub-diagram", group: "sheet", text: "A diagram within this one, empty." },
  { type: MACHINE, name: "State machine", group: "sheet", text: "A chart of states and transitions: mode logic." },
];
const STATES: readonly Choice[] = [{ type: STATE, name: "State", group: "chart", text: "A state of this chart." }];
const GAP = 60;

const withSubtract = (one: Choice): Choice[] =>
  one.type === "sum"
    ? [one, { ...one, type: SUBTRACT, name: "Subtract", text: "y = a - b: a Sum with + and -." }]
    : [one];

class Choices {
  readonly all: readonly Choice[] = $derived(
    editor.here.chart ? STATES : [...OWN, ...(editor.catalogue?.blocks.flatMap(withSubtract) ?? [])],
  );

  fitting({ from, to }: Loose): Choice[] {
    const shapes = new Map(editor.catalogue?.blocks.map((one) => [one.type, one.shape]));
    return this.all.filter(({ type }) => {
      const shape = shapes.get(type);
      if (type === "parameter") return from === null && to === null;
      if (type === "input") return from === null;
      if (type === "output") return to === null;
      if (shape === undefined) return true; // a sub-diagram has one of each
      if (!("inputs" in shape)) return false;
      return (from === null || shape.inputs.length > 0) && (to === null || shape.outputs.length > 0);
    });
  }
}
export const choices = new Choices();

/** Return the wire at the selection into which a block is inserted. */
export function looseEnd(middle: Point): Loose {
  const [id = ""] = editor.selected;
  const [d, name] = [editor.here, id.slice(2)];
  const places = placesOn(d, editor.shapes);
  const beside = (at: Point | undefined, dx: number): Point => (at === undefined ? middle : [at[0] + dx, at[1] + 20]);
  const own = places.get(id);
  if (id.startsWith("w:")) {
    const from = sourceOf(d, name) ?? null;
    const end = places.get(partId(name.split(".")[0]!)) ?? places.get(outputId(name));
    return { from, to: name, at: beside(end, -100 - GAP) };
  }
  if (id.startsWith("o:")) return { from: null, to: name, at: beside(own, -100 - GAP) };
  if (id.startsWith("i:")) return { from: name, to: null, at: beside(own, 60 + GAP) };
  const part = findPart(d, name);
  const port = part === undefined ? undefined : tops(editor.shapes.of(part.item).outputs)[0];
  if (part === undefined || port === undefined) return { from: null, to: null, at: middle };
  return { from: sourceText(part, port, editor.shapes), to: null, at: beside(own, 100 + GAP) };
}

/** Put a block, input, output or parameter at the wire: one step to undo. */
export function insert(type: string, { from, to, at }: Loose): void {
  if (type === "input" || type === "output" || type === "parameter") return addBorder(type, "insert", from, to);
  const part = made(type, [at[0], at[1] - 20]);
  if (part === undefined) return;
  const shape = editor.shapes.of(part.item);
  const [[input], [output]] = [tops(shape.inputs), tops(shape.outputs)];
  editor.apply(`insert ${part.name}`, (d) => {
    let after = addPart(d, part);
    if (from !== null && input !== undefined) after = connect(after, from, `${part.name}.${input}`);
    if (to !== null && output !== undefined) after = connect(after, sourceText(part, output, editor.shapes), to);
    return after;
  });
  editor.select([partId(part.name)]);
}
