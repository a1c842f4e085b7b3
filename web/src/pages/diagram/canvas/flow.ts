// From a diagram to the nodes and edges that xyflow draws. What did not change is given back as the very same object, so
// that only what changed is drawn anew: 300 blocks must not cost a tenth of a second.
import { MarkerType, Position, type Edge, type Node, type NodeHandle } from "@xyflow/svelte";
import type { Diagram, Part, Point } from "../model/diagram";
import { declaredName, inputId, inputNames, outputId, partId, wireId, wiresOf } from "../model/diagram";
import { textOf, turnsOf } from "../model/chart";
import { portOf, sourceEnd, tops, type Port, type Shape, type Shapes } from "../model/shapes";
import { partPlaces, TERMINAL_HEIGHT, terminalPlaces, terminalWidth } from "./places";
import type { Box, Ends, Route, Router } from "./route";
import { partSize, portPlace, type Size } from "./symbol";

export interface PartData extends Record<string, unknown> {
  readonly part: Part;
  readonly shape: Shape;
  readonly size: Size;
  readonly inputs: readonly string[];
  readonly outputs: readonly string[];
  /** Problems, one per line. */
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
export type SheetEdge = Edge<{ color: string; fault: boolean; label: string; route: Route }>;

/** Marks on the sheet, by id. */
export interface Marks {
  readonly faults: ReadonlyMap<string, string>;
  readonly loop: ReadonlySet<string>;
  /** Colour of the scope, by destination. */
  readonly scoped: ReadonlyMap<string, string>;
  readonly selected: ReadonlySet<string>;
}

const HANDLE = 7; // the dot of a port
const SLICE_MS = 6; // of a frame, for the bends of wires
const ARROW = { type: MarkerType.ArrowClosed, width: 14, height: 14 } as const;

/** Nodes and edges; `left`: some wires are to be routed by another call. */
export interface Drawn {
  readonly nodes: SheetNode[];
  readonly edges: SheetEdge[];
  readonly left: boolean;
}

/** Return nodes and edges of a sheet; unchanged ones are reused. */
export function sheet(d: Diagram, shapes: Shapes, marks: Marks, before: Omit<Drawn, "left">, router: Router): Drawn {
  const old = new Map(before.nodes.map((node) => [node.id, node]));
  const places = partPlaces(d, shapes);
  const nodes: SheetNode[] = d.parts.map((part, i) =>
    partNode(part, shapes, places[i]!, marks, old.get(partId(part.name)) as PartNode | undefined),
  );
  const terminals = terminalPlaces(d, shapes, places);
  for (const [kind, names] of [
    ["input", d.chart ? [] : inputNames(d)],
    ["output", d.chart ? [] : d.outputs.map(([name]) => name)],
  ] as const) {
    names.forEach((name) => {
      const declared = d.inputs.find((one) => declaredName(one) === name);
      const source = d.outputs.find(([one]) => one === name)?.[1] ?? null;
      const port =
        kind === "output"
          ? { ...shapes.carried(d, source), name }
          : declared === undefined
            ? { name, kind: "bus", width: null, unit: "" }
            : portOf(declared);
      const id = kind === "input" ? inputId(name) : outputId(name);
      nodes.push(terminal(kind, id, port, terminals.get(id)!, marks, old.get(id) as TerminalNode | undefined));
    });
  }
  return { nodes, ...edges(d, shapes, marks, before.edges, nodes, router) };
}

/**
 * Of what is to be drawn as much as one frame takes: what is there already, and `most` of what is new. Where there is more
 * of that, it begins with the next frame: the edit that made it has taken its time already (`begun`: it is the next).
 */
export function firstOf(drawn: Drawn, before: { nodes: readonly SheetNode[] }, most: number, begun: boolean): Drawn {
  const there = new Set(before.nodes.map((node) => node.id));
  const fresh = drawn.nodes.filter((node) => !there.has(node.id)).length;
  let some = begun || fresh <= most ? 0 : most;
  const nodes = drawn.nodes.filter((node) => there.has(node.id) || some++ < most);
  if (nodes.length === drawn.nodes.length) return drawn;
  const ids = new Set(nodes.map((node) => node.id));
  const edges = drawn.edges.filter((edge) => ids.has(edge.source) && ids.has(edge.target));
  return { nodes, edges, left: true };
}

/** Return ports with their sizes, so that xyflow need not measure them. */
function handles(size: Size, inputs: readonly string[], outputs: readonly string[], flipped: boolean): NodeHandle[] {
  const at = (type: "source" | "target", id: string, y: number): NodeHandle => ({
    id,
    type,
    position: (type === "source") === flipped ? Position.Left : Position.Right,
    x: ((type === "source") === flipped ? 0 : size.width) - HANDLE / 2,
    y: y - HANDLE / 2,
    width: HANDLE,
    height: HANDLE,
  });
  const y = (i: number, ports: readonly string[]): number => portPlace(i, ports.length, size.height);
  return [
    ...inputs.map((port, i) => at("target", `in:${port}`, y(i, inputs))),
    ...outputs.map((port, i) => at("source", `out:${port}`, y(i, outputs))),
  ];
}

function partNode(part: Part, shapes: Shapes, [x, y]: Point, marks: Marks, old: PartNode | undefined): PartNode {
  const id = partId(part.name);
  const shape = shapes.of(part.item);
  const chosen = marks.selected.has(id);
  const [inputs, outputs] = [tops(shape.inputs), tops(shape.outputs)];
  const [fault, loop] = [marks.faults.get(id) ?? "", marks.loop.has(id)];
  const data: PartData = { part, shape, size: partSize(part, shape), inputs, outputs, fault, loop };
  const same = old !== undefined && alike(placeless(old.data), placeless(data));
  if (same && isAt(old, x, y, chosen)) return old;
  return {
    ...(old ?? {}),
    id,
    type: "part",
    position: { x, y },
    ...data.size,
    measured: data.size,
    handles: same ? old.handles! : handles(data.size, inputs, outputs, part.flipped),
    selected: chosen,
    data: same ? old.data : data,
    focusable: false,
    ariaLabel: part.name,
  };
}

function placeless({ part, shape, fault, loop }: PartData) {
  return { ...part, position: null, presumed: null, shape, fault, loop };
}

function alike<T extends object>(one: T, other: T): boolean {
  return (Object.keys(other) as (keyof T)[]).every((key) => one[key] === other[key]);
}

function isAt(node: SheetNode, x: number, y: number, chosen: boolean): boolean {
  return node.position.x === x && node.position.y === y && (node.selected ?? false) === chosen;
}

function terminal(
  kind: "input" | "output",
  id: string,
  port: Port,
  [x, y]: Point,
  marks: Marks,
  old: TerminalNode | undefined,
): TerminalNode {
  const fault = marks.faults.get(id) ?? "";
  const same = old?.data.fault === fault && old.data.port.kind === port.kind && old.data.port.unit === port.unit;
  const chosen = marks.selected.has(id);
  if (same && isAt(old, x, y, chosen)) return old;
  const size = { width: terminalWidth(port.name), height: TERMINAL_HEIGHT };
  const dot = { width: HANDLE, height: HANDLE, y: (TERMINAL_HEIGHT - HANDLE) / 2 };
  return {
    ...(old ?? {}),
    id,
    type: kind === "input" ? "inlet" : "outlet",
    position: { x, y },
    ...size,
    measured: size,
    handles: [
      kind === "input"
        ? { ...dot, id: "out", type: "source", position: Position.Right, x: size.width - HANDLE / 2 }
        : { ...dot, id: "in", type: "target", position: Position.Left, x: -HANDLE / 2 },
    ],
    selected: chosen,
    data: same ? old.data : { name: port.name, port, fault },
    focusable: false,
    ariaLabel: `${kind} ${port.name}`,
  };
}

export function extentOf(nodes: readonly SheetNode[]): Box {
  if (nodes.length === 0) return { x: 0, y: 0, width: 400, height: 200 };
  const boxes = nodes.map(boxOf);
  const [x, y] = [Math.min(...boxes.map((box) => box.x)), Math.min(...boxes.map((box) => box.y))];
  const right = Math.max(...boxes.map((box) => box.x + box.width));
  const bottom = Math.max(...boxes.map((box) => box.y + box.height));
  return { x, y, width: right - x, height: bottom - y };
}

function boxOf(node: SheetNode): Box {
  return { ...node.position, width: node.width ?? 0, height: node.height ?? 0 };
}

function isFlipped(node: SheetNode): boolean {
  return node.type === "part" && node.data.part.flipped;
}

function portAt(node: SheetNode, handle: string, side: "in" | "out"): Point {
  const box = boxOf(node);
  const x = (side === "in") === isFlipped(node) ? box.x + box.width : box.x;
  if (node.type !== "part") return [x, box.y + box.height / 2];
  const ports = side === "in" ? node.data.inputs : node.data.outputs;
  return [x, box.y + portPlace(Math.max(0, ports.indexOf(handle.slice(side.length + 1))), ports.length, box.height)];
}

function edges(
  d: Diagram,
  shapes: Shapes,
  marks: Marks,
  before: readonly SheetEdge[],
  nodes: readonly SheetNode[],
  router: Router,
): { edges: SheetEdge[]; left: boolean } {
  const at = new Map(nodes.map((node) => [node.id, node]));
  const wires = wireEnds(d, shapes).filter((wire) => hasPort(at, wire));
  const ends = wires.map((wire): Ends => {
    const [from, to] = [at.get(wire.source)!, at.get(wire.target)!];
    const ways = { out: isFlipped(from) ? "left" : "right", in: isFlipped(to) ? "left" : "right" } as const;
    return {
      id: wire.id,
      from: portAt(from, wire.sourceHandle, "out"),
      to: portAt(to, wire.targetHandle, "in"),
      way: ways.out === ways.in ? ways.out : "round",
    };
  });
  const left = router.update(new Map(nodes.map((node) => [node.id, boxOf(node)])), ends, SLICE_MS);
  const old = new Map(before.map((edge) => [edge.id, edge]));
  return {
    edges: wires.map((wire) => edge(wire, wayText(d, wire.to), router.route(wire.id), marks, old.get(wire.id))),
    left,
  };
}

interface WireEnds {
  readonly id: string;
  readonly from: string;
  readonly to: string;
  readonly source: string;
  readonly sourceHandle: string;
  readonly target: string;
  readonly targetHandle: string;
}

function wireEnds(d: Diagram, shapes: Shapes): WireEnds[] {
  return wiresOf(d).flatMap(([from, to]) => {
    const end = sourceEnd(d, shapes, from);
    if (end === undefined) return [];
    const isOutput = !to.includes(".");
    const [part = "", ...port] = to.split(".");
    return [
      {
        id: wireId(to),
        from,
        to,
        source: end[0] === null ? inputId(end[1].split(".")[0]!) : partId(end[0]),
        sourceHandle: end[0] === null ? "out" : `out:${end[1].split(".")[0]}`,
        target: isOutput ? outputId(to) : partId(part),
        targetHandle: isOutput ? "in" : `in:${port[0] ?? ""}`,
      },
    ];
  });
}

function hasPort(at: ReadonlyMap<string, SheetNode>, wire: WireEnds): boolean {
  const [from, to] = [at.get(wire.source), at.get(wire.target)];
  const has = (node: SheetNode | undefined, handle: string): boolean =>
    node?.handles?.some((one) => one.id === handle) ?? false;
  return has(from, wire.sourceHandle) && has(to, wire.targetHandle);
}

function wayText(d: Diagram, to: string): string {
  const way = d.chart?.ways[to.split(".")[1] ?? ""];
  if (way === undefined) return "";
  return `${turnsOf(d, to).turn + 1}: ${textOf(way["when"]) || "always"}${textOf(way["do"]) && ` / ${textOf(way["do"])}`}`;
}

function edge(wire: WireEnds, label: string, route: Route, marks: Marks, was: SheetEdge | undefined): SheetEdge {
  const { id, from, to, source, sourceHandle, target, targetHandle } = wire;
  const fault = marks.loop.has(id);
  const color = marks.scoped.get(to) ?? "";
  const ends = { source, sourceHandle, target, targetHandle, selected: marks.selected.has(id) };
  const { x, y } = route;
  const [old, next] = [was?.data, { color, fault, label, x, y }];
  const same = was !== undefined && old !== undefined && alike<object>({ ...old, ...old.route }, next);
  if (same && alike<object>(was, ends)) return was;
  return {
    ...(was ?? {}),
    ...ends,
    id,
    type: "wire",
    markerEnd: ARROW,
    data: { color, fault, label, route },
    class: fault ? "loop" : color === "" ? "" : "scoped",
    style: color === "" ? "" : `--wire: var(--${color})`,
    focusable: false,
    ariaLabel: `wire from ${from} to ${to}`,
  };
}
