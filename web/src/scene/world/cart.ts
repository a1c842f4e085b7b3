import { Group } from "three";
import { BAR_HEIGHT, BAR_RADIUS, BAR_SIDE, BEARING_HEIGHT, CART_HALF, SUPPORT_SIDE } from "../dimensions";
import type { Materials } from "./materials";
import { box, rodX, rodZ } from "./shapes";

/** The cart: bearings on the two bars, a plate, the uprights that hold the drone, and the range sensor. */
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
