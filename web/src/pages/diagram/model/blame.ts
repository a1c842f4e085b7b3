// Where a finding belongs: the path that Python names, as what is on a sheet.
import { opens } from "./chart";
import { declaredName, diagramAt, EMPTY, findPart, type Diagram, type Part } from "./diagram";

/** Place of a finding: path of the sheet, and id of a part (p:), input (i:) or output (o:), "" for the sheet. */
export interface Place {
  readonly path: readonly string[];
  readonly id: string;
  /** Port or argument. */
  readonly rest: string;
}

/** Find the place of "sub.gain.u" or "diagram.sub.gain.u". */
export function placeOfFinding(root: Diagram, where: string): Place {
  const segments = where.split(/[.,] ?/).filter(Boolean);
  const direct = walk(root, segments);
  if (direct.id !== "" || segments[0] !== root.name) return direct;
  return walk(root, segments.slice(1));
}

function walk(root: Diagram, segments: readonly string[]): Place {
  const path: string[] = [];
  let here = root;
  for (const [i, name] of segments.entries()) {
    const rest = segments.slice(i + 1).join(".");
    const part = findPart(here, name);
    if (part === undefined) {
      if (here.inputs.some((one) => declaredName(one).split(".")[0] === name)) return { path, id: `i:${name}`, rest };
      if (here.outputs.some(([one]) => one === name)) return { path, id: `o:${name}`, rest };
      break;
    }
    const last = segments[i + 1];
    if (part.item.is === "block" && opens(part)) return { path, id: `p:${name}`, ...onChart(path, part, rest), rest };
    if (part.item.is === "block" || last === undefined) return { path, id: `p:${name}`, rest };
    const inner = findPart(part.item, last);
    // A port of a sub-diagram is its block's fault as seen from outside.
    if (inner === undefined) return { path, id: `p:${name}`, rest };
    path.push(name);
    here = part.item;
  }
  return { path, id: "", rest: segments.join(".") };
}

/** Find the state or the transition of a chart that Python names. */
function onChart(path: readonly string[], part: Part, rest: string): Partial<Place> {
  const [, from, to, state] = /(?:when|do) of (\w+) -> (\w+)|(?:entry|during|exit) of (\w+)/.exec(rest) ?? [];
  const wires = diagramAt({ ...EMPTY, parts: [part] }, [part.name])!.connections;
  const end = wires.find(([source, end]) => source === from && end.split(".")[0] === to)?.[1];
  const id = state ? `p:${state}` : end ? `w:${end}` : "";
  return id === "" ? {} : { path: [...path, part.name], id };
}

/** Return the id that shows a place on the sheet at `at`, or "". */
export function seenFrom(at: readonly string[], place: Place): string {
  if (!at.every((name, i) => place.path[i] === name)) return "";
  const below = place.path[at.length];
  return below === undefined ? place.id : `p:${below}`;
}

/** Return the parts and wires of an algebraic loop on the sheet at `at`. */
export function loopOnSheet(
  root: Diagram,
  at: readonly string[],
  here: Diagram,
  signals: readonly string[],
): Set<string> {
  const parts = signals.map((signal) => seenFrom(at, placeOfFinding(root, signal)));
  const on = new Set(parts.filter((id) => id !== ""));
  const found = new Set(on);
  for (const [source, to] of here.connections) {
    const from = `p:${source.split(".")[0]}`;
    const there = `p:${to.split(".")[0]}`;
    // signals[i] needs signals[i + 1]: the wire goes from the latter's part to the former's.
    const joined = parts.some((id, i) => id === there && parts[i + 1] === from);
    if (on.has(from) && on.has(there) && joined) found.add(`w:${to}`);
  }
  return found;
}
