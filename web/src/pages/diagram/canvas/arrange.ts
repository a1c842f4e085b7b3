// Automatic layout by elkjs, in a worker of its own: signals flow from left to right.
import type { ElkNode } from "elkjs/lib/elk-api";
import { inputNames, wiresOf, type Diagram, type Part, type Point } from "../model/diagram";
import { sourceEnd, tops, type Shapes } from "../model/shapes";
import { partSize, portPlace } from "./symbol";

const OPTIONS = {
  "elk.algorithm": "layered",
  "elk.direction": "RIGHT",
  "elk.layered.spacing.nodeNodeBetweenLayers": "50",
  "elk.spacing.nodeNode": "40",
  "elk.spacing.edgeNode": "20",
  "elk.layered.nodePlacement.strategy": "NETWORK_SIMPLEX",
  "elk.layered.nodePlacement.favorStraightEdges": "true",
  "elk.layered.crossingMinimization.semiInteractive": "true",
};
const SNAP = 10;
const MOST_SHEETS = 40;
const PATIENCE_MS = 3000;

/** Return the graph of a sheet, inputs in the first layer and outputs in the last. */
export function graphOf(d: Diagram, shapes: Shapes): ElkNode {
  const side = (where: "WEST" | "EAST") => ({ "elk.port.side": where });
  const children: ElkNode[] = d.parts.map((part) => {
    const shape = shapes.of(part.item);
    const size = partSize(part, shape);
    const [inward, outward] = part.flipped ? (["EAST", "WEST"] as const) : (["WEST", "EAST"] as const);
    const ports = (names: readonly string[], mark: string, where: "WEST" | "EAST") =>
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
      ports: [...ports(tops(shape.inputs), "<", inward), ...ports(tops(shape.outputs), ">", outward)],
      layoutOptions: { "elk.portConstraints": "FIXED_POS" },
    };
  });
  const border = (id: string, layer: string): ElkNode => ({
    id,
    width: 40,
    height: 20,
    layoutOptions: { "elk.layered.layering.layerConstraint": layer },
  });
  children.push(...inputNames(d).map((n) => border(`i:${n}`, "FIRST")));
  children.push(...d.outputs.map(([name]) => border(`o:${name}`, "LAST")));
  const known = new Set(children.flatMap((child) => [child.id, ...(child.ports ?? []).map((port) => port.id)]));
  const edges = wiresOf(d).flatMap(([source, to], i) => {
    const end = sourceEnd(d, shapes, source);
    if (end === undefined) return [];
    const from = end[0] === null ? `i:${end[1].split(".")[0]}` : `p:${end[0]}>${end[1].split(".")[0]}`;
    const [part, port] = to.split(".");
    const there = port === undefined ? `o:${to}` : `p:${part}<${port}`;
    return known.has(from) && known.has(there) ? [{ id: `e${i}`, sources: [from], targets: [there] }] : [];
  });
  return { id: "root", layoutOptions: OPTIONS, children, edges };
}

export async function arranged(d: Diagram, shapes: Shapes): Promise<Map<string, Point>> {
  const [places] = await layouts([d], shapes);
  return places!;
}

/** Arrange each sheet on which no part has a position. */
export async function presumed(d: Diagram, shapes: Shapes): Promise<Diagram> {
  const sheets = unplaced(d);
  if (sheets.length === 0 || sheets.length > MOST_SHEETS) return d;
  let late: ReturnType<typeof setTimeout> | undefined;
  const given = new Promise<undefined>((done) => (late = setTimeout(() => done(undefined), PATIENCE_MS)));
  // Who waits in vain sees the parts in rows.
  const places = await Promise.race([layouts(sheets, shapes).catch(() => undefined), given]);
  clearTimeout(late);
  return places === undefined ? d : placed(d, new Map(sheets.map((sheet, i) => [sheet, places[i]!])));
}

function unplaced(d: Diagram): Diagram[] {
  const inner = d.parts.flatMap(({ item }) => (item.is === "diagram" ? unplaced(item) : []));
  const own = d.parts.length > 1 && d.parts.every((part) => part.position === null);
  return own ? [d, ...inner] : inner;
}

function placed(d: Diagram, places: ReadonlyMap<Diagram, ReadonlyMap<string, Point>>): Diagram {
  const own = places.get(d);
  const parts = d.parts.map((part): Part => {
    const at = own?.get(part.name);
    const item = part.item.is === "diagram" ? placed(part.item, places) : part.item;
    if (at === undefined && item === part.item) return part;
    return { ...part, item, ...(at === undefined ? {} : { presumed: at }) };
  });
  return parts.every((part, i) => part === d.parts[i]) ? d : { ...d, parts };
}

async function layouts(sheets: readonly Diagram[], shapes: Shapes): Promise<Map<string, Point>[]> {
  const [{ default: Elk }, { default: place }] = await Promise.all([
    import("elkjs/lib/elk-api"),
    import("elkjs/lib/elk-worker.min.js?url"),
  ]);
  const worker = new Worker(place);
  const elk = new Elk({ workerFactory: () => worker });
  try {
    const found: Map<string, Point>[] = [];
    for (const sheet of sheets) found.push(placesOf(await elk.layout(graphOf(sheet, shapes))));
    return found;
  } finally {
    worker.terminate();
  }
}

function placesOf(graph: ElkNode): Map<string, Point> {
  const parts = (graph.children ?? []).filter((child) => child.id.startsWith("p:"));
  const [left, top] = [Math.min(...parts.map((p) => p.x ?? 0)), Math.min(...parts.map((p) => p.y ?? 0))];
  const snap = (v: number): number => SNAP * Math.round(v / SNAP);
  return new Map(
    parts.map((p) => [p.id.slice(2), [snap((p.x ?? 0) - left) + 160, snap((p.y ?? 0) - top) + 20] as const]),
  );
}
