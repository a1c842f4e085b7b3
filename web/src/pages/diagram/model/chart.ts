// A state machine as a chart: a diagram whose blocks are states and whose wires are transitions, in their order. The wire
// of transition 3 ends at the port t3 of its target; each state has a free port for one more.
import { declaredName, EMPTY, type Block, type Diagram, type Part, type Point } from "./diagram";
import { changePart, EditFault, renamePart, written } from "./edits";
import { isList, isObject, Num, type Json, type JsonObject } from "./json_text";

export const MACHINE = "state_machine";
export const STATE = "state";
export const NEW_MACHINE: Block = {
  ...{ is: "block", type: MACHINE },
  json: { type: MACHINE, name: "Chart", inputs: [{ name: "u" }], outputs: [{ name: "y" }], nodes: [] },
};
export const NEW_STATE: Block = {
  ...{ is: "block", type: STATE },
  json: { type: STATE, name: "", outer: "", inputs: [{ name: "t" }], outputs: [{ name: "then" }] },
};

/** Return whether a part has a sheet of its own. */
export function opens({ item }: Part): boolean {
  return item.is === "diagram" || item.type === MACHINE;
}

const objects = (json: Json | undefined): readonly JsonObject[] => (isList(json) ? json.filter(isObject) : []);
const charts = new WeakMap<Block, Diagram>();

/** Return a guard or an action as it is shown; what Python recorded has no text. */
export function textOf(json: Json | undefined): string {
  return typeof json === "string" ? json : json instanceof Num || isObject(json) ? "recorded from Python" : "";
}

export function chartOf(block: Block): Diagram {
  let chart = charts.get(block);
  if (chart === undefined) charts.set(block, (chart = read(block.json)));
  return chart;
}

function read(json: JsonObject): Diagram {
  const transitions = objects(json["transitions"]);
  const parts: Part[] = [];
  const add = (mode: JsonObject, outer: string): void => {
    const { name: _, inner, position, ...own } = mode;
    const name = declaredName(mode);
    const ports = transitions.flatMap(({ to }, i) => (to === name ? [`t${i}`] : []));
    const words = [outer && `in ${outer}:`, objects(inner).length > 0 ? "outer" : textOf(own["during"])];
    const item: Block = {
      ...NEW_STATE,
      json: {
        ...{ ...NEW_STATE.json, ...own, outer, name: `${parts.length === 0 ? "● " : ""}${words.join(" ").trim()}` },
        inputs: [...ports, `t${transitions.length}`].map((port) => ({ name: port })),
      },
    };
    const free: Point = [260 * (parts.length % 4), 140 * Math.floor(parts.length / 4)];
    const at = isList(position) ? (position as Num[]) : written(free);
    parts.push({ name, rate: null, params: {}, conditions: {}, rest: {}, position: at, flipped: false, item });
    objects(inner).forEach((one) => add(one, name));
  };
  objects(json["modes"]).forEach((mode) => add(mode, ""));
  return {
    ...{ ...EMPTY, name: declaredName(json), parts, params: objects(json["params"]), inputs: objects(json["inputs"]) },
    outputs: objects(json["outputs"]).map((one) => [declaredName(one), null] as const),
    connections: transitions.map(({ from, to }, i) => [textOf(from), `${textOf(to)}.t${i}`] as const),
    chart: {
      ...{ ports: objects(json["outputs"]), variables: objects(json["variables"]) },
      ways: Object.fromEntries(transitions.map(({ from: _, to: __, ...way }, i) => [`t${i}`, way])),
    },
  };
}

/** Return the block that an edited chart is. Raises EditFault for a chart with more than states and transitions. */
export function blockOf(block: Block, d: Diagram): Block {
  const { ports, variables, ways } = d.chart!;
  const names = new Set(d.parts.map((part) => part.name));
  const states = d.parts.map(({ name, position, item }) => {
    if (item.is === "diagram" || item.type !== STATE) throw new EditFault("a chart has states and transitions only");
    const { type: _, name: __, inputs: ___, outputs: ____, outer, ...own } = item.json;
    return { outer: names.has(textOf(outer)) ? outer : "", json: { name, ...own, ...(position && { position }) } };
  });
  const within = (outer: string): JsonObject[] =>
    states.flatMap((state) => {
      if (state.outer !== outer) return [];
      const [inner, { history, ...json }] = [within(state.json.name), state.json as JsonObject];
      return [inner.length === 0 ? json : { ...json, ...(history === true && { history }), inner }];
    });
  const transitions = d.connections.map(([from, end]) => {
    const [to = "", port = ""] = end.split(".");
    if (!names.has(from) || !names.has(to)) throw new EditFault("a transition leads from a state to a state");
    return { from, to, ...(ways[port] ?? { when: "" }) };
  });
  const outputs = d.outputs.map(
    ([name], i) =>
      ports.find((one) => declaredName(one) === name) ?? { ...(d.outputs.length === ports.length && ports[i]), name },
  );
  const { inputs, params } = d;
  return {
    ...block,
    json: { ...block.json, inputs, outputs, variables, params, name: d.name, modes: within(""), transitions },
  };
}

/** Set a property of a state; an empty one goes. */
export function setState(d: Diagram, name: string, key: string, value: string | boolean): Diagram {
  return changePart(d, name, (part) => {
    if (part.item.is === "diagram") return part;
    const { [key]: _, ...rest } = part.item.json;
    return { ...part, item: { ...part.item, json: value || key === "outer" ? { ...rest, [key]: value } : rest } };
  });
}

export function renameState(d: Diagram, from: string, to: string): Diagram {
  const inner = d.parts.filter(({ item }) => item.is === "block" && item.json["outer"] === from);
  return inner.reduce((after, { name }) => setState(after, name, "outer", to), renamePart(d, from, to));
}

/** Let the machine, or the state around it, start in a state. */
export function startIn(d: Diagram, name: string): Diagram {
  return { ...d, parts: [...d.parts].sort((a, b) => Number(b.name === name) - Number(a.name === name)) };
}

/** Set the guard (when) or the action (do) of the transition that ends at `to`. */
export function setWay(d: Diagram, to: string, key: "when" | "do", value: string): Diagram {
  const port = to.split(".")[1]!;
  const ways = { ...d.chart!.ways, [port]: { ...d.chart!.ways[port], [key]: value } };
  return { ...d, chart: { ...d.chart!, ways } };
}

/** Return the transitions out of the state that the one to `to` leaves, as indices into `connections`, and its turn. */
export function turnsOf(d: Diagram, to: string): { turns: number[]; turn: number } {
  const at = d.connections.findIndex(([, end]) => end === to);
  const turns = d.connections.flatMap(([from], i) => (from === d.connections[at]?.[0] ? [i] : []));
  return { turns, turn: turns.indexOf(at) };
}

/** Exchange two transitions. */
export function exchanged(d: Diagram, a: number, b: number): Diagram {
  const order = new Map([[a, b] as const, [b, a] as const]);
  return { ...d, connections: d.connections.map((_, i) => d.connections[order.get(i) ?? i]!) };
}
