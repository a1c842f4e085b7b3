import { CircleGeometry, ConeGeometry, CylinderGeometry, Group, type Material, type Mesh, PlaneGeometry } from "three";
import { ARM, BODY_HALF, FULL_THRUST, ROTOR_HEIGHT, ROTOR_RADIUS, ROTOR_SIDE, SUPPORT_SIDE } from "../dimensions";
import type { Materials } from "./materials";
import { box, hoop, rodZ, shaped } from "./shapes";

const PLACES = [
  [ARM, -ROTOR_SIDE],
  [ARM, ROTOR_SIDE],
  [-ARM, -ROTOR_SIDE],
  [-ARM, ROTOR_SIDE],
] as const;
const HEAD = 0.026;

/** Drone with its bearing at the origin; it pitches about z. */
export class DroneBody {
  readonly group = new Group();
  private readonly blades: Mesh[] = [];
  private readonly arrows: { shaft: Mesh; head: Mesh; group: Group }[] = [];
  private turned = 0;

  constructor(materials: Materials) {
    const { carbon, guard, nose, thrust, disc, blade } = materials;
    frame(this.group, carbon, guard);
    this.group.add(rodZ(materials.metal, 0.004, 2 * SUPPORT_SIDE, 0, 0, 0));
    // The nose has the colour of the estimate: one sees at once which end is fore.
    this.group.add(box(nose, [0.034, 0.02, 0.062], [BODY_HALF + 0.006, 0.003, 0]));
    for (const [x, z] of PLACES) {
      const rotor = shaped(new CircleGeometry(ROTOR_RADIUS - 0.004, 40), disc, x, ROTOR_HEIGHT, z);
      rotor.rotation.x = -Math.PI / 2;
      this.group.add(rotor);
      const wing = shaped(new PlaneGeometry(2 * ROTOR_RADIUS - 0.012, 0.011), blade, x, ROTOR_HEIGHT + 0.001, z);
      wing.rotation.set(-Math.PI / 2, 0, 0.6);
      this.blades.push(wing);
      this.group.add(wing);
      const arrow = new Group();
      arrow.position.set(x, ROTOR_HEIGHT + 0.004, z);
      const shaft = shaped(new CylinderGeometry(0.0055, 0.0055, 1, 12), thrust);
      const head = shaped(new ConeGeometry(0.0145, HEAD, 18), thrust);
      arrow.add(shaft, head);
      this.arrows.push({ shaft, head, group: arrow });
      this.group.add(arrow);
    }
  }

  /** Show commands as arrows; `moving` turns the blades. */
  thrust(fore: number, aft: number, moving: boolean): void {
    const commands = [fore, fore, aft, aft];
    if (moving) this.turned += 0.9;
    this.arrows.forEach(({ shaft, head, group }, k) => {
      const command = commands[k]!;
      const length = Math.max(0, FULL_THRUST * command - HEAD);
      group.visible = command > 0.01;
      shaft.scale.y = Math.max(length, 1e-4);
      shaft.position.y = length / 2;
      head.position.y = length + HEAD / 2;
      this.blades[k]!.rotation.z = 0.6 + (command > 0.01 ? (k % 3 === 0 ? 1 : -1) * this.turned : 0);
    });
  }
}

export function ghostBody(material: Material): Group {
  const group = new Group();
  frame(group, material, material);
  return group;
}

function frame(group: Group, carbon: Material, guard: Material): void {
  group.add(box(carbon, [2 * BODY_HALF, 0.026, 0.06], [0, 0.002, 0]));
  group.add(box(carbon, [2 * BODY_HALF * 0.8, 0.016, 0.036], [0, -0.018, 0]));
  for (const [x, z] of PLACES) {
    const length = Math.hypot(x, z);
    const arm = box(carbon, [length, 0.009, 0.014], [x / 2, 0, z / 2]);
    arm.rotation.y = -Math.atan2(z, x);
    group.add(arm);
    group.add(shaped(new CylinderGeometry(0.011, 0.012, ROTOR_HEIGHT, 18), carbon, x, ROTOR_HEIGHT / 2 - 0.002, z));
    group.add(hoop(guard, ROTOR_RADIUS, 0.0032, x, ROTOR_HEIGHT, z));
  }
}
