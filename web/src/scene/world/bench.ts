import type { BufferGeometry, Mesh } from "three";
import { CanvasTexture, CircleGeometry, Group, MeshBasicMaterial, PlaneGeometry } from "three";
import { written } from "../../design/units";
import { BAR_HEIGHT, BAR_RADIUS, BAR_SIDE, BEARING_HEIGHT, CART_HALF } from "../dimensions";
import { DEPTH, LENGTH, PROFILE, RAIL_STOP, SUPPORT_SIDE } from "../dimensions";
import { Label } from "./labels";
import type { Materials } from "./materials";
import { box, rodX, rodZ, shaped } from "./shapes";

export function bench(materials: Materials): { group: Group; labels: Label[] } {
  const group = new Group();
  const { metal, steel, rubber, scale } = materials;
  const half = PROFILE / 2;
  const [endX, sideZ] = [LENGTH / 2 - half, DEPTH / 2 - half];
  const rise = BAR_HEIGHT + 0.03;
  for (const z of [-sideZ, sideZ]) group.add(box(metal, [LENGTH, PROFILE, PROFILE], [0, half, z]));
  for (const x of [-endX, endX]) {
    group.add(box(metal, [PROFILE, PROFILE, DEPTH - 2 * PROFILE], [x, half, 0]));
    for (const z of [-sideZ, sideZ])
      group.add(box(metal, [PROFILE, rise - PROFILE, PROFILE], [x, PROFILE + (rise - PROFILE) / 2, z]));
    group.add(box(metal, [PROFILE, PROFILE, DEPTH - 2 * PROFILE], [x, BAR_HEIGHT, 0]));
  }
  for (const z of [-BAR_SIDE, BAR_SIDE]) {
    group.add(rodX(steel, BAR_RADIUS, LENGTH - 2 * PROFILE, 0, BAR_HEIGHT, z));
    // The cart's face meets these when the bearing is at +-RAIL_STOP.
    for (const side of [-1, 1]) {
      const inner = RAIL_STOP + CART_HALF;
      const length = LENGTH / 2 - PROFILE - inner;
      group.add(rodX(rubber, 2.4 * BAR_RADIUS, length, side * (inner + length / 2), BAR_HEIGHT, z));
    }
  }
  const labels: Label[] = [];
  const front = DEPTH / 2 + 0.05;
  group.add(box(scale, [2 * RAIL_STOP, 0.0015, 0.0015], [0, 0.001, front - 0.025]));
  for (let tick = -8; tick <= 8; tick += 1) {
    const x = tick * 0.05;
    const long = tick % 4 === 0;
    group.add(box(scale, [0.0018, 0.0015, long ? 0.022 : 0.011], [x, 0.001, front - 0.025 + (long ? 0.011 : 0.0055)]));
    if (long) {
      const label = new Label(tick === 0 ? "0" : written(x.toFixed(1)) + (tick === 8 ? " m" : ""), 0.032, [
        x,
        0.004,
        front + 0.03,
      ]);
      labels.push(label);
      group.add(label.sprite);
    }
  }
  group.add(shadow(new PlaneGeometry(1.5, 0.62), -0.001));
  return { group, labels };
}

/** Build the cart: bearings, plate, uprights and range sensor. */
export function cart(materials: Materials): Group {
  const group = new Group();
  const { plate, metal, carbon } = materials;
  const top = BAR_HEIGHT + 0.016;
  group.add(box(plate, [2 * CART_HALF, 0.006, 2 * SUPPORT_SIDE + 0.008], [0, top, 0]));
  for (const z of [-BAR_SIDE, BAR_SIDE])
    for (const side of [-1, 1])
      group.add(rodX(metal, 2.2 * BAR_RADIUS, 0.032, side * (CART_HALF - 0.017), BAR_HEIGHT, z));
  for (const z of [-SUPPORT_SIDE, SUPPORT_SIDE]) {
    const high = BEARING_HEIGHT - top;
    group.add(box(plate, [0.024, high, 0.006], [0, top + high / 2, z]));
    group.add(rodZ(metal, 0.014, 0.012, 0, BEARING_HEIGHT, z));
  }
  group.add(box(carbon, [0.014, 0.018, 0.026], [-CART_HALF - 0.004, top + 0.012, 0]));
  return group;
}

export function rings(materials: Materials): Group {
  const group = new Group();
  for (const z of [-BAR_SIDE, BAR_SIDE])
    for (const side of [-1, 1])
      group.add(rodX(materials.ring, 3 * BAR_RADIUS, 0.014, side * (CART_HALF + 0.009), BAR_HEIGHT, z));
  return group;
}

export const dropShadow = (): Mesh => shadow(new CircleGeometry(0.2, 32), 0.001);

/** Build a soft shadow that lies at height `y`. */
function shadow(geometry: BufferGeometry, y: number): Mesh {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 128;
  const ctx = canvas.getContext("2d")!;
  const fade = ctx.createRadialGradient(64, 64, 8, 64, 64, 64);
  fade.addColorStop(0, "rgba(0,0,0,0.30)");
  fade.addColorStop(0.6, "rgba(0,0,0,0.12)");
  fade.addColorStop(1, "rgba(0,0,0,0)");
  ctx.fillStyle = fade;
  ctx.fillRect(0, 0, 128, 128);
  const map = new CanvasTexture(canvas);
  const mesh = shaped(
    geometry,
    new MeshBasicMaterial({ map, transparent: true, depthWrite: false, color: 0 }),
    0,
    y,
    0,
  );
  mesh.rotation.x = -Math.PI / 2;
  return mesh;
}
