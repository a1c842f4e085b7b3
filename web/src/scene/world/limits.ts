import { Group, RingGeometry, type Mesh } from "three";
import { PITCH_STOP } from "../dimensions";
import { Label } from "./labels";
import type { Materials } from "./materials";
import { box, shaped } from "./shapes";

const INNER = 0.194;
const OUTER = 0.208;

/** Arc of the pitch up to its stops, with needles of pitch and set-point. */
export class PitchLimits {
  readonly group = new Group();
  readonly labels: Label[];
  private readonly wanted: Mesh;
  private readonly needle: Mesh;

  constructor(materials: Materials, side: number) {
    const arc = shaped(new RingGeometry(INNER, OUTER, 64, 1, -PITCH_STOP, 2 * PITCH_STOP), materials.limit);
    this.group.add(arc);
    for (const angle of [-PITCH_STOP, 0, PITCH_STOP]) {
      const mark = box(materials.limitEdge, [OUTER - INNER + 0.012, 0.002, 0.002], [0, 0, 0]);
      mark.position.set(((INNER + OUTER) / 2) * Math.cos(angle), ((INNER + OUTER) / 2) * Math.sin(angle), 0);
      mark.rotation.z = angle;
      this.group.add(mark);
    }
    const far = OUTER + 0.03;
    this.labels = [
      new Label("50°", 0.03, [far * Math.cos(PITCH_STOP), far * Math.sin(PITCH_STOP), 0]),
      new Label("−50°", 0.03, [far * Math.cos(PITCH_STOP), -far * Math.sin(PITCH_STOP), 0]),
    ];
    for (const label of this.labels) this.group.add(label.sprite);
    this.needle = this.hand(materials.nose, 0.006, 0.034);
    this.wanted = this.hand(materials.wanted, 0.005, 0.05);
    this.group.position.z = side;
  }

  show(theta: number, wanted: number | undefined): void {
    this.needle.parent!.rotation.z = theta;
    this.wanted.visible = wanted !== undefined;
    if (wanted !== undefined) this.wanted.parent!.rotation.z = wanted;
  }

  private hand(material: Parameters<typeof box>[0], thick: number, length: number): Mesh {
    const group = new Group();
    const hand = box(material, [length, thick, 0.002], [(INNER + OUTER) / 2, 0, 0.001]);
    group.add(hand);
    this.group.add(group);
    return hand;
  }
}
