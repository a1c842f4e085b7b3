// Blocks become a sub-diagram, and a sub-diagram its blocks.
import type { Connection, Diagram, Output, Part, Point } from "./diagram";
import { declaredName, EMPTY, findPart, placeOf } from "./diagram";
import { declared, EditFault, freeName, movePart, namer, newPart, taken } from "./edits";
import type { JsonObject } from "./json_text";
import type { Shapes } from "./shapes";

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
  const fresh = namer(taken);
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
    ...EMPTY,
    name,
    inputs: [...inputs.values()],
    params: d.params.filter((one) => params.includes(declaredName(one))),
    parts: inside,
    connections: inner,
    outputs: [...outputs].map(([source, output]) => [output, source] as const),
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

const MOST_STEPS = 200;

/** Put the parts of a sub-diagram in its place, at `places`; returns their names too. */
export function ungrouped(
  d: Diagram,
  name: string,
  places: readonly Point[],
): { diagram: Diagram; names: readonly string[] } {
  const outer = findPart(d, name);
  if (outer?.item.is !== "diagram") throw new EditFault(`${name} is not a sub-diagram`);
  if (Object.keys(outer.conditions).length > 0 || outer.rate !== null) {
    throw new EditFault(`${name} has a condition or a rate of its own, which its blocks would lose: remove it first`);
  }
  const sub = outer.item;
  const free = namer(new Set([...taken(d)].filter((one) => one !== name)));
  const names = new Map(sub.parts.map((part) => [part.name, free(part.name)]));
  const params = new Map(sub.params.map(declaredName).map((one) => [one, outer.params[one] ?? free(one)]));
  const lifted = sub.params.filter((one) => outer.params[declaredName(one)] === undefined);
  const fed = new Map(d.connections.filter(([, to]) => to.split(".")[0] === name).map(([from, to]) => [to, from]));
  const given = new Map(sub.outputs);

  /** Follow a source on the outer sheet to what gives it; null where that is not connected. */
  function outside(source: string, steps = 0): string | null {
    const [part, ...path] = source.split(".");
    if (part !== name) return source;
    if (steps > MOST_STEPS) throw new EditFault(`a wire of ${name} leads back to itself: delete it first`);
    const named = given.has(path[0] ?? "") || given.size !== 1;
    const inner = named ? given.get(path[0] ?? "") : [...given.values()][0];
    return inner === null || inner === undefined
      ? null
      : inside([inner, ...path.slice(named ? 1 : 0)].join("."), steps);
  }
  function inside(source: string, steps = 0): string | null {
    const [first = "", ...path] = source.split(".");
    const part = names.get(first);
    if (part !== undefined) return [part, ...path].join(".");
    for (let n = path.length; n >= 0; n--) {
      const from = fed.get([name, first, ...path.slice(0, n)].join("."));
      if (from !== undefined) return outside([from, ...path.slice(n)].join("."), steps + 1);
    }
    return null;
  }
  const conditioned = (part: Part, follow: (source: string) => string | null): Part => {
    const kept = Object.entries(part.conditions).map(([key, source]) => [key, follow(source)] as const);
    const lost = kept.find(([, source]) => source === null);
    if (lost) throw new EditFault(`the ${lost[0]} of ${part.name} is not connected: connect it first`);
    return { ...part, conditions: Object.fromEntries(kept) };
  };
  const [left, top] = [Math.min(...places.map(([x]) => x)), Math.min(...places.map(([, y]) => y))];
  const [x, y] = placeOf(outer) ?? [0, 0];
  const inner = sub.parts.map((part, i): Part => {
    const bound = Object.entries(part.params).map(([own, one]) => [own, params.get(one) ?? one]);
    const [px, py] = places[i]!;
    const moved = movePart({ ...part, name: names.get(part.name)! }, [x + px - left, y + py - top]);
    return conditioned({ ...moved, params: Object.fromEntries(bound) }, inside);
  });
  const wire = (from: string | null, to: string): Connection[] => (from === null ? [] : [[from, to]]);
  return {
    names: [...names.values()],
    diagram: {
      ...d,
      params: [...d.params, ...lifted.map((one) => ({ ...one, name: params.get(declaredName(one))! }))],
      parts: d.parts.flatMap((part) => (part === outer ? inner : [conditioned(part, outside)])),
      connections: [
        ...d.connections.filter(([, to]) => to.split(".")[0] !== name).flatMap(([from, to]) => wire(outside(from), to)),
        ...sub.connections.flatMap(([from, to]) => {
          const [part = "", ...port] = to.split(".");
          return wire(inside(from), [names.get(part) ?? part, ...port].join("."));
        }),
      ],
      outputs: d.outputs.map(([one, source]) => [one, source === null ? null : outside(source)] as const),
    },
  };
}

function stem(source: string): string {
  return source.replace(/\./g, "_").slice(0, 56);
}
