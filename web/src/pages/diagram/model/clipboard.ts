// Copy and paste. What is copied travels as JSON text, so it goes from one page to another through the system's clipboard.
import type { Connection, Diagram, Part } from "./diagram";
import { declaredName, partFrom, partTo, placeOf, DiagramFault } from "./diagram";
import { movePart, namer, taken } from "./edits";
import { isList, isObject, readJson, writeJson } from "./json_text";

const SCHEMA = "twodof/parts";
const STEP = 30;
const MOST = 10_000;

export function copyText(d: Diagram, names: ReadonlySet<string>): string {
  const inside = (end: string): boolean => names.has(end.split(".")[0] ?? "");
  const isInput = (source: string): boolean => d.inputs.some((one) => declaredName(one) === source);
  return writeJson({
    schema: SCHEMA,
    parts: d.parts
      .filter((part) => names.has(part.name))
      .map((part) => partTo(movePart(part, placeOf(part) ?? [0, 0]))),
    connections: d.connections.filter(([source, to]) => inside(source) && !isInput(source) && inside(to)),
  });
}

/** Read a text of `copyText`. Raises JsonFault or DiagramFault. */
function copied(text: string): { parts: Part[]; connections: Connection[] } {
  const json = readJson(text);
  if (!isObject(json) || json["schema"] !== SCHEMA || !isList(json["parts"]) || !isList(json["connections"])) {
    throw new DiagramFault("the clipboard does not hold blocks");
  }
  const pairs = json["connections"].filter(
    (one): one is [string, string] => isList(one) && typeof one[0] === "string" && typeof one[1] === "string",
  );
  if (json["parts"].length > MOST) throw new DiagramFault(`more than ${MOST} blocks`);
  return { parts: json["parts"].map(partFrom), connections: pairs.map(([a, b]) => [a, b] as const) };
}

/** Paste a text under free names, a little aside. */
export function paste(d: Diagram, text: string): { diagram: Diagram; names: string[] } {
  const { parts, connections } = copied(text);
  const free = namer(taken(d));
  const names = new Map(parts.map(({ name }) => [name, free(name)]));
  const follow = (end: string): string => {
    const [name = "", ...port] = end.split(".");
    return [names.get(name) ?? name, ...port].join(".");
  };
  const known = new Set(d.params.map(declaredName));
  const made = parts.map((part): Part => {
    const kept = Object.entries(part.conditions).filter(([, source]) => names.has(source.split(".")[0] ?? ""));
    const bound = Object.entries(part.params).filter(([, outer]) => known.has(outer));
    const [x, y] = placeOf(part) ?? [0, 0];
    return movePart(
      {
        ...part,
        name: follow(part.name),
        params: Object.fromEntries(bound),
        conditions: Object.fromEntries(kept.map(([key, source]) => [key, follow(source)])),
      },
      [x + STEP, y + STEP],
    );
  });
  const wires = connections.map(([source, to]) => [follow(source), follow(to)] as const);
  return {
    diagram: { ...d, parts: [...d.parts, ...made], connections: [...d.connections, ...wires] },
    names: [...names.values()],
  };
}
