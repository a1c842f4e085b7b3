// Blocks become a sub-diagram: what comes in and goes out of them becomes its inputs and outputs.
import { declaredName, placeOf, type Connection, type Diagram, type Output } from "./diagram";
import { freeName, newPart, EditFault } from "./edits";
import { Num, type JsonObject } from "./json_text";
import type { Port, Shapes } from "./shapes";

/** Move parts into a new sub-diagram; returns its name too. */
export function grouped(d: Diagram, names: ReadonlySet<string>, shapes: Shapes): { diagram: Diagram; name: string } {
  const inside = d.parts.filter((part) => names.has(part.name));
  if (inside.length === 0) throw new EditFault("select the blocks of the sub-diagram");
  for (const part of inside) {
    if (Object.keys(part.conditions).length > 0) {
      throw new EditFault(`${part.name} is enabled, reset or triggered from outside: leave it there`);
    }
  }
  const name = freeName(d, "sub");
  const own = (source: string): boolean =>
    names.has(source.split(".")[0] ?? "") && !d.inputs.some((one) => declaredName(one).split(".")[0] === source);
  const inputs = new Map<string, JsonObject>(); // outer source -> the input
  const outputs = new Map<string, string>(); // inner source -> the output
  const taken = new Set(inside.map((part) => part.name));
  const fresh = (wanted: string): string => {
    let made = wanted;
    for (let n = 2; taken.has(made); n++) made = `${wanted}_${n}`;
    taken.add(made);
    return made;
  };
  const inner: Connection[] = [];
  const outer: Connection[] = [];
  for (const [source, to] of d.connections) {
    const there = names.has(to.split(".")[0] ?? "");
    if (there && own(source)) inner.push([source, to]);
    else if (there) {
      if (!inputs.has(source)) inputs.set(source, declared(fresh(stem(source)), shapes.carried(d, source)));
      inner.push([declaredName(inputs.get(source)!), to]);
    } else outer.push([own(source) ? out(source) : source, to]);
  }
  function out(source: string): string {
    if (!outputs.has(source)) outputs.set(source, fresh(stem(source)));
    return `${name}.${outputs.get(source)}`;
  }
  const rest: Output[] = d.outputs.map(([one, source]) => [one, source !== null && own(source) ? out(source) : source]);
  const params = [...new Set(inside.flatMap((part) => Object.values(part.params)))];
  const sub: Diagram = {
    is: "diagram",
    name,
    text: "",
    inputs: [...inputs.values()],
    params: d.params.filter((one) => params.includes(declaredName(one))),
    parts: inside,
    connections: inner,
    outputs: [...outputs].map(([source, output]) => [output, source] as const),
    inputPositions: {},
    outputPositions: {},
  };
  const clash = sub.params.map(declaredName).find((one) => taken.has(one));
  if (clash !== undefined) throw new EditFault(`${clash} would name a parameter and a block of the sub-diagram`);
  const [x, y] = inside.map((part) => placeOf(part) ?? [0, 0]).reduce(([a, b], [c, e]) => [a + c, b + e], [0, 0]);
  const part = newPart(d, name, sub, [Math.round(x / inside.length), Math.round(y / inside.length)]);
  const bound = { ...part, params: Object.fromEntries(params.map((one) => [one, one])) };
  // A bus's or a single port's name alone would be read anew: what is read is written whole.
  const short = (source: string): string => (outputs.size === 1 && source.startsWith(`${name}.`) ? name : source);
  return {
    name,
    diagram: {
      ...d,
      parts: [...d.parts.filter((one) => !names.has(one.name)), bound],
      connections: [
        ...outer.map(([source, to]) => [short(source), to] as const),
        ...[...inputs].map(([source, input]) => [source, `${name}.${declaredName(input)}`] as const),
      ],
      outputs: rest.map(([one, source]) => [one, source === null ? null : short(source)] as const),
    },
  };
}

function stem(source: string): string {
  return source.replace(/\./g, "_").slice(0, 56);
}

function declared(name: string, port: Port): JsonObject {
  return {
    name,
    ...(port.kind === "real" ? {} : { kind: port.kind }),
    ...(port.width === null ? {} : { width: new Num(String(port.width)) }),
    ...(port.unit === "" ? {} : { unit: port.unit }),
  };
}
