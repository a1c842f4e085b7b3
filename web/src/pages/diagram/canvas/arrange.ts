// Automatic layout by elkjs, in a worker of its own: signals flow from left to right.
import type { ElkNode } from "elkjs/lib/elk-api";
import { declaredName, type Diagram, type Point } from "../model/diagram";
import { sourceEnd, tops, type Shapes } from "../model/shapes";
import { partSize, portPlace } from "./symbol";

const OPTIONS = {
  "elk.algorithm": "layered",
  "elk.direction": "RIGHT",
  "elk.layered.spacing.nodeNodeBetweenLayers": "60",
  "elk.spacing.nodeNode": "40",
  "elk.spacing.edgeNode": "20",
  "elk.layered.nodePlacement.strategy": "NETWORK_SIMPLEX",
  "elk.layered.nodePlacement.favorStraightEdges": "true",
  "elk.layered.crossingMinimization.semiInteractive": "true",
};
const SNAP = 10;

/** The graph that is laid out: parts with their ports, inputs in the first layer, outputs in the last. */
export function graphOf(d: Diagram, shapes: Shapes): ElkNode {
  const side = (where: "WEST" | "EAST") => ({ "elk.port.side": where });
  const children: ElkNode[] = d.parts.map((part) => {
    const shape = shapes.of(part.item);
    const size = partSize(part, shape);
    const ports = (names: string[], mark: string, where: "WEST" | "EAST") =>
      names.map((name, i) => ({
        id: `p:${part.name}${mark}${name}`,
        x: where === "WEST" ? 0 : size.width,
        y: portPlace(i, names.length, size.height),
        width: 0,
        height: 0,
        layoutOptions: side(where),
      }));
    return {
      id: `p:${part.name}`,
      width: size.width,
      height: size.height + 16, // its name stands below
      ports: [...ports(tops(shape.inputs), "<", "WEST"), ...ports(tops(shape.outputs), ">", "EAST")],
      layoutOptions: { "elk.portConstraints": "FIXED_POS" },
    };
  });
  const border = (id: string, layer: string): ElkNode => ({
    id,
    width: 40,
    height: 24,
    layoutOptions: { "elk.layered.layering.layerConstraint": layer },
  });
  children.push(
    ...[...new Set(d.inputs.map((one) => declaredName(one).split(".")[0]!))].map((n) => border(`i:${n}`, "FIRST")),
  );
  children.push(...d.outputs.map(([name]) => border(`o:${name}`, "LAST")));
  const known = new Set(children.flatMap((child) => [child.id, ...(child.ports ?? []).map((port) => port.id)]));
  const wires = [...d.connections, ...d.outputs.map(([name, source]) => [source ?? "", name] as const)];
  const edges = wires.flatMap(([source, to], i) => {
    const end = source === "" ? undefined : sourceEnd(d, shapes, source);
    if (end === undefined) return [];
    const from = end[0] === null ? `i:${end[1].split(".")[0]}` : `p:${end[0]}>${end[1].split(".")[0]}`;
    const [part, port] = to.split(".");
    const there = port === undefined ? `o:${to}` : `p:${part}<${port}`;
    return known.has(from) && known.has(there) ? [{ id: `e${i}`, sources: [from], targets: [there] }] : [];
  });
  return { id: "root", layoutOptions: OPTIONS, children, edges };
}

/** New places of all parts. */
export async function arranged(d: Diagram, shapes: Shapes): Promise<Map<string, Point>> {
  const [{ default: Elk }, { default: place }] = await Promise.all([
    import("elkjs/lib/elk-api"),
    import("elkjs/lib/elk-worker.min.js?url"),
  ]);
  const worker = new Worker(place);
  const elk = new Elk({ workerFactory: () => worker });
  try {
    const placed = await elk.layout(graphOf(d, shapes));
    const parts = (placed.children ?? []).filter((child) => child.id.startsWith("p:"));
    const [left, top] = [Math.min(...parts.map((p) => p.x ?? 0)), Math.min(...parts.map((p) => p.y ?? 0))];
    const snap = (v: number): number => SNAP * Math.round(v / SNAP);
    return new Map(
      parts.map((p) => [p.id.slice(2), [snap((p.x ?? 0) - left) + 160, snap((p.y ?? 0) - top) + 20] as const]),
    );
  } finally {
    worker.terminate();
  }
}
