// Wires made by a click: what is selected to what was clicked, without a word about ports.
import { type Connection, type Diagram, findPart } from "./diagram";
import { connect, EditFault } from "./edits";
import { sourceEnd, sourceText, tops, type Shapes } from "./shapes";

/**
 * `d` with a wire from each of `from` to an input of `to` that is free, in their order; those that find none stay as they
 * are. All are ids on the sheet. Raises EditFault where no wire can be made.
 */
export function joined(d: Diagram, shapes: Shapes, from: readonly string[], to: string): Diagram {
  const free = freeInputs(d, shapes, to);
  const name = to.slice(2);
  if (free.length === 0) {
    throw new EditFault(to.startsWith("i:") ? `${name} is an input: it takes no wire` : `${name} has no free input`);
  }
  const read = outputsRead(d, shapes);
  const sources = from.flatMap((id) => outputOf(d, shapes, id, read) ?? []);
  if (sources.length === 0) throw new EditFault("the selection has no output");
  const wires = sources.slice(0, free.length).map((source, i): Connection => [source, free[i]!]);
  return wires.reduce((after, wire) => connect(after, ...wire), d);
}

function freeInputs(d: Diagram, shapes: Shapes, id: string): string[] {
  const name = id.slice(2);
  if (id.startsWith("o:")) return d.outputs.some(([one, source]) => one === name && source === null) ? [name] : [];
  const part = id.startsWith("p:") ? findPart(d, name) : undefined;
  if (part === undefined) return [];
  const fed = d.connections.map(([, to]) => to);
  const isFed = (port: string): boolean => fed.some((to) => to === port || to.startsWith(`${port}.`));
  return tops(shapes.of(part.item).inputs)
    .map((port) => `${name}.${port}`)
    .filter((port) => !isFed(port));
}

/** "part.port" of the outputs that something reads. */
function outputsRead(d: Diagram, shapes: Shapes): ReadonlySet<string> {
  const conditions = d.parts.flatMap((part) => Object.values(part.conditions));
  const sources = [...d.connections.map(([source]) => source), ...d.outputs.map(([, source]) => source), ...conditions];
  const ends = sources.map((source) => (source === null ? undefined : sourceEnd(d, shapes, source)));
  return new Set(ends.flatMap((end) => (end === undefined ? [] : [`${end[0]}.${end[1].split(".")[0]}`])));
}

/** The first output that nobody reads, or else the first: an output may be read by many. */
function outputOf(d: Diagram, shapes: Shapes, id: string, read: ReadonlySet<string>): string | undefined {
  const name = id.slice(2);
  if (id.startsWith("i:")) return name;
  const part = id.startsWith("p:") ? findPart(d, name) : undefined;
  if (part === undefined) return undefined;
  const ports = tops(shapes.of(part.item).outputs);
  const port = ports.find((one) => !read.has(`${name}.${one}`)) ?? ports[0];
  return port === undefined ? undefined : sourceText(part, port, shapes);
}
