// From a diagram to the nodes and edges that xyflow draws. What did not change is given back as the very same object, so
// that only what changed is drawn anew: 300 blocks must not cost a tenth of a second.
import { MarkerType, type Edge, type Node } from "@xyflow/svelte";
import { inputId, outputId, partId, wireId } from "../editor.svelte";
import { declaredName, placeOf, type Diagram, type Part, type Point } from "../model/diagram";
import { portOf, sourceEnd, tops, type Port, type Shape, type Shapes } from "../model/shapes";
import { routed, type Box, type Route } from "./route";
import { partSize, portPlace, type Size } from "./symbol";

export interface PartData extends Record<string, unknown> {
  readonly part: Part;
  readonly shape: Shape;
  readonly size: Size;
  readonly inputs: readonly string[];
  readonly outputs: readonly string[];
  /** What is wrong with it, a sentence a line; "" if nothing is. */
  readonly fault: string;
  readonly loop: boolean;
}
export interface TerminalData extends Record<string, unknown> {
  readonly name: string;
  readonly port: Port;
  readonly fault: string;
}
export type PartNode = Node<PartData, "part">;
export type TerminalNode = Node<TerminalData, "inlet" | "outlet">;
export type SheetNode = PartNode | TerminalNode;
export type SheetEdge = Edge<{ color: string; fault: boolean; route: Route }>;

/** What is told of the sheet beside the diagram itself, by id. */
export interface Marks {
  readonly faults: ReadonlyMap<string, string>;
  readonly loop: ReadonlySet<string>;
  /** Wires that a scope shows: destination -> colour. */
  readonly scoped: ReadonlyMap<string, string>;
}

export const TERMINAL_HEIGHT = 24;
const GAP = 60;

function terminalWidth(name: string): number {
  return Math.min(190, Math.max(50, 10 * Math.ceil((name.length * 6.6 + 18) / 10)));
}

/** Nodes and edges of a sheet, which keep what they can of those before. */
export function sheet(
  d: Diagram,
  shapes: Shapes,
  marks: Marks,
  selected: ReadonlySet<string>,
  before: { nodes: readonly SheetNode[]; edges: readonly SheetEdge[] },
): { nodes: SheetNode[]; edges: SheetEdge[] } {
  const old = new Map(before.nodes.map((node) => [node.id, node]));
  const places = partPlaces(d, shapes);
  const nodes: SheetNode[] = d.parts.map((part, i) =>
    partNode(part, shapes, places[i]!, marks, selected, old.get(partId(part.name)) as PartNode | undefined),
  );
  const terminals = terminalPlaces(d, shapes, places);
  for (const [kind, names] of [
    ["input", [...new Set(d.inputs.map((one) => declaredName(one).split(".")[0]!))]],
    ["output", d.outputs.map(([name]) => name)],
  ] as const) {
    names.forEach((name) => {
      const id = kind === "input" ? inputId(name) : outputId(name);
      const declared = d.inputs.find((one) => declaredName(one) === name);
      const source = d.outputs.find(([one]) => one === name)?.[1] ?? null;
      const port =
        kind === "output"
          ? { ...shapes.carried(d, source), name }
          : declared === undefined
            ? { name, kind: "bus", width: null, unit: "" }
            : portOf(declared);
      nodes.push(
        terminal(kind, id, port, terminals.get(id)!, marks, selected, old.get(id) as TerminalNode | undefined),
      );
    });
  }
  return { nodes, edges: edges(d, shapes, marks, selected, before.edges, nodes) };
}

function partNode(
  part: Part,
  shapes: Shapes,
  [x, y]: Point,
  marks: Marks,
  selected: ReadonlySet<string>,
  old: PartNode | undefined,
): PartNode {
  const id = partId(part.name);
  const shape = shapes.of(part.item);
  const fault = marks.faults.get(id) ?? "";
  const loop = marks.loop.has(id);
  const chosen = selected.has(id);
  const same =
    old !== undefined &&
    old.data.part.item === part.item &&
    old.data.part.params === part.params &&
    old.data.part.name === part.name &&
    old.data.part.conditions === part.conditions &&
    old.data.part.rate === part.rate &&
    old.data.shape === shape &&
    old.data.fault === fault &&
    old.data.loop === loop;
  if (same && old.position.x === x && old.position.y === y && (old.selected ?? false) === chosen) return old;
  const size = partSize(part, shape);
  const ports = { inputs: tops(shape.inputs), outputs: tops(shape.outputs) };
  const data: PartData = same ? old.data : { part, shape, size, ...ports, fault, loop };
  return {
    ...(old ?? {}),
    id,
    type: "part",
    position: { x, y },
    width: size.width,
    height: size.height,
    selected: chosen,
    data,
    focusable: false,
    ariaLabel: part.name,
  };
}

function terminal(
  kind: "input" | "output",
  id: string,
  port: Port,
  [x, y]: Point,
  marks: Marks,
  selected: ReadonlySet<string>,
  old: TerminalNode | undefined,
): TerminalNode {
  const fault = marks.faults.get(id) ?? "";
  const was = old?.data;
  const same = was !== undefined && was.fault === fault && was.port.kind === port.kind && was.port.unit === port.unit;
  const chosen = selected.has(id);
  if (same && old!.position.x === x && old!.position.y === y && (old!.selected ?? false) === chosen) return old!;
  return {
    ...(old ?? {}),
    id,
    type: kind === "input" ? "inlet" : "outlet",
    position: { x, y },
    width: terminalWidth(port.name),
    height: TERMINAL_HEIGHT,
    selected: chosen,
    draggable: false,
    data: same ? was : { name: port.name, port, fault },
    focusable: false,
    ariaLabel: `${kind} ${port.name}`,
  };
}

/** Where parts stand; those without a place in the file get one below the others. */
export function partPlaces(d: Diagram, shapes: Shapes): Point[] {
  const placed = d.parts.map(placeOf);
  const bottom = Math.max(
    0,
    ...placed.map((at, i) => (at === null ? 0 : at[1] + partSize(d.parts[i]!, shapes.of(d.parts[i]!.item)).height)),
  );
  let free = 0;
  return placed.map((at) => at ?? ([160 * (free % 6), bottom + GAP + 100 * Math.floor(free++ / 6)] as const));
}

/** Inputs stand left of all parts, outputs right of them, each at the height of what it is wired to, if there is room. */
function terminalPlaces(d: Diagram, shapes: Shapes, places: readonly Point[]): Map<string, Point> {
  const sizes = d.parts.map((part) => partSize(part, shapes.of(part.item)));
  const middle = new Map(d.parts.map((part, i) => [part.name, places[i]![1] + sizes[i]!.height / 2]));
  const left = Math.min(GAP, ...places.map(([x]) => x)) - GAP;
  const right = Math.max(GAP, ...places.map(([x], i) => x + sizes[i]!.width)) + GAP;
  const found = new Map<string, Point>();
  const inputs = [...new Set(d.inputs.map((one) => declaredName(one).split(".")[0]!))].map((name) => {
    const to = d.connections.find(([source]) => source.split(".")[0] === name)?.[1].split(".")[0] ?? "";
    return [inputId(name), middle.get(to)] as const;
  });
  const outputs = d.outputs.map(([name, source]) => [outputId(name), middle.get(source?.split(".")[0] ?? "")] as const);
  for (const [rows, x] of [
    [inputs, left],
    [outputs, right],
  ] as const) {
    let next = -Infinity;
    const lowest = Math.max(0, ...[...middle.values()]);
    for (const [id, at] of rows.map(([id, y]) => [id, y ?? lowest] as const).sort((a, b) => a[1] - b[1])) {
      const y = Math.max(10 * Math.round((at - TERMINAL_HEIGHT / 2) / 10), next);
      found.set(id, [x === left ? x - terminalWidth(id.slice(2)) : x, y]);
      next = y + 40;
    }
  }
  return found;
}

function boxOf(node: SheetNode): Box {
  return { ...node.position, width: node.width ?? 0, height: node.height ?? 0 };
}

/** Where a wire begins at a node, or ends. */
function portAt(node: SheetNode, handle: string, side: "in" | "out"): Point {
  const box = boxOf(node);
  const x = side === "in" ? box.x : box.x + box.width;
  if (node.type !== "part") return [x, box.y + box.height / 2];
  const ports = side === "in" ? node.data.inputs : node.data.outputs;
  return [x, box.y + portPlace(Math.max(0, ports.indexOf(handle.slice(side.length + 1))), ports.length, box.height)];
}

function edges(
  d: Diagram,
  shapes: Shapes,
  marks: Marks,
  selected: ReadonlySet<string>,
  before: readonly SheetEdge[],
  nodes: readonly SheetNode[],
): SheetEdge[] {
  const boxes = nodes.map(boxOf);
  const at = new Map(nodes.map((node) => [node.id, node]));
  const old = new Map(before.map((edge) => [edge.id, edge]));
  const made: SheetEdge[] = [];
  const wires = [
    ...d.connections,
    ...d.outputs.flatMap(([name, source]) => (source === null ? [] : [[source, name] as const])),
  ];
  const outputs = new Set(d.outputs.map(([name]) => name));
  for (const [source, to] of wires) {
    const end = sourceEnd(d, shapes, source);
    if (end === undefined) continue;
    const id = wireId(to);
    const isOutput = outputs.has(to) && !to.includes(".");
    const [part = "", ...port] = to.split(".");
    const from = end[0] === null ? inputId(end[1].split(".")[0]!) : partId(end[0]);
    const fault = marks.loop.has(id);
    const color = marks.scoped.get(to) ?? "";
    const next = {
      source: from,
      sourceHandle: end[0] === null ? "out" : `out:${end[1].split(".")[0]}`,
      target: isOutput ? outputId(to) : partId(part),
      targetHandle: isOutput ? "in" : `in:${port[0] ?? ""}`,
      selected: selected.has(id),
    };
    const was = old.get(id);
    const [begin, finish] = [at.get(next.source), at.get(next.target)];
    const route =
      begin === undefined || finish === undefined
        ? {}
        : routed(portAt(begin, next.sourceHandle, "out"), portAt(finish, next.targetHandle, "in"), boxes);
    const same =
      was !== undefined &&
      was.data?.route.x === route.x &&
      was.data?.route.y === route.y &&
      was.source === next.source &&
      was.sourceHandle === next.sourceHandle &&
      was.target === next.target &&
      was.targetHandle === next.targetHandle &&
      (was.selected ?? false) === next.selected &&
      was.data?.color === color &&
      was.data.fault === fault;
    made.push(
      same
        ? was
        : {
            ...(was ?? {}),
            id,
            type: "wire",
            markerEnd: { type: MarkerType.ArrowClosed, width: 14, height: 14 },
            ...next,
            data: { color, fault, route },
            class: fault ? "loop" : color === "" ? "" : "scoped",
            style: color === "" ? "" : `--wire: var(--${color})`,
            focusable: false,
            ariaLabel: `wire from ${source} to ${to}`,
          },
    );
  }
  return made;
}
