// Ends of wires: sources and destinations to choose from, and wires made by a click.
import { findPart, wiresOf, type Connection, type Diagram } from "./diagram";
import { connect, EditFault } from "./edits";
import { portOf, portText, sourceEnd, sourceText, tops, type Port, type Shapes } from "./shapes";

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

function outputsRead(d: Diagram, shapes: Shapes): ReadonlySet<string> {
  const conditions = d.parts.flatMap((part) => Object.values(part.conditions));
  const sources = [...d.connections.map(([source]) => source), ...d.outputs.map(([, source]) => source), ...conditions];
  const ends = sources.map((source) => (source === null ? undefined : sourceEnd(d, shapes, source)));
  return new Set(ends.flatMap((end) => (end === undefined ? [] : [`${end[0]}.${end[1].split(".")[0]}`])));
}

/** Return the first unread output, or else the first. */
function outputOf(d: Diagram, shapes: Shapes, id: string, read: ReadonlySet<string>): string | undefined {
  const name = id.slice(2);
  if (id.startsWith("i:")) return name;
  const part = id.startsWith("p:") ? findPart(d, name) : undefined;
  if (part === undefined) return undefined;
  const ports = tops(shapes.of(part.item).outputs);
  const port = ports.find((one) => !read.has(`${name}.${one}`)) ?? ports[0];
  return port === undefined ? undefined : sourceText(part, port, shapes);
}

export interface End {
  readonly text: string;
  readonly owner: string;
  readonly about: string;
  /** Source of a destination; "" if it is free. */
  readonly from: string;
}

function end(text: string, port: Port | undefined, from = ""): End {
  const about = port === undefined ? "" : ` ${portText(port)}`.replace(/^ real/, "");
  return { text, owner: text.split(".")[0]!, about, from };
}

/** Return the destinations of the wires at a node, incoming ones first. */
export function wiresAt(d: Diagram, id: string): string[] {
  const name = id.slice(2);
  if (id.startsWith("o:")) return d.outputs.flatMap(([one, source]) => (one === name && source !== null ? [one] : []));
  const into = d.connections.filter(([, to]) => id.startsWith("p:") && to.split(".")[0] === name);
  const out = wiresOf(d).filter(([source]) => source.split(".")[0] === name);
  return [...new Set([...into, ...out].map(([, to]) => to))];
}

export function sourcesOf(d: Diagram, shapes: Shapes): End[] {
  const inputs = d.inputs.map(portOf);
  const parts = d.parts.flatMap((part) => {
    const { outputs } = shapes.of(part.item);
    const named = (port: string): Port | undefined => outputs.find((one) => one.name === port);
    return tops(outputs).map((port) => end(sourceText(part, port, shapes), named(port)));
  });
  return [
    ...parts,
    ...tops(inputs).map((name) =>
      end(
        name,
        inputs.find((one) => one.name === name),
      ),
    ),
  ];
}

export function destinationsOf(d: Diagram, shapes: Shapes): End[] {
  const fed = new Map(d.connections.map(([source, to]) => [to, source]));
  const parts = d.parts.flatMap(({ name, item }) => {
    const { inputs } = shapes.of(item);
    return tops(inputs).map((port) => {
      const text = `${name}.${port}`;
      return end(
        text,
        inputs.find((one) => one.name === port),
        fed.get(text),
      );
    });
  });
  return [
    ...parts,
    ...d.outputs.map(([name, source]) => ({ ...end(name, undefined, source ?? ""), about: " output" })),
  ];
}
