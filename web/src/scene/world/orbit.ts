import { MathUtils, type PerspectiveCamera, Vector3 } from "three";

const HOME = { round: 0.34, up: 0.24 };
const TARGET = new Vector3(0, 0.155, 0);

/** Camera around the rig, turned by drag or arrow keys. */
export class Orbit {
  private round = HOME.round;
  private up = HOME.up;

  constructor(
    private readonly camera: PerspectiveCamera,
    private readonly changed: () => void,
  ) {}

  listen(target: HTMLElement, keep: AbortSignal): void {
    let from: { x: number; y: number } | undefined;
    const on = <K extends keyof HTMLElementEventMap>(name: K, what: (event: HTMLElementEventMap[K]) => void): void =>
      target.addEventListener(name, what, { signal: keep });
    target.style.touchAction = "pan-y";
    on("pointerdown", (event) => {
      if (event.button !== 0) return;
      target.setPointerCapture(event.pointerId);
      from = { x: event.clientX, y: event.clientY };
    });
    on("pointermove", (event) => {
      if (from === undefined) return;
      this.turn((from.x - event.clientX) * 0.008, (event.clientY - from.y) * 0.006);
      from = { x: event.clientX, y: event.clientY };
    });
    on("pointerup", () => (from = undefined));
    on("pointercancel", () => (from = undefined));
    on("dblclick", () => this.home());
    on("keydown", (event) => {
      const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.08], ArrowDown: [0, -0.08] }[event.key];
      if (event.key === "Home") this.home();
      else if (step) this.turn(step[0]!, step[1]!);
      else return;
      event.preventDefault();
    });
  }

  turn(round: number, up: number): void {
    this.round += round;
    this.up = MathUtils.clamp(this.up + up, 0.02, 1.4);
    this.place();
  }

  home(): void {
    Object.assign(this, HOME);
    this.place();
  }

  /** Place the camera so that the whole rail is visible. */
  place(): void {
    const wide = 2 * Math.atan(Math.tan(MathUtils.degToRad(this.camera.fov) / 2) * this.camera.aspect);
    const far = Math.max(0.63 / Math.tan(wide / 2), 0.275 / Math.tan(MathUtils.degToRad(this.camera.fov) / 2)) + 0.2;
    this.camera.position
      .set(Math.sin(this.round) * Math.cos(this.up), Math.sin(this.up), Math.cos(this.round) * Math.cos(this.up))
      .multiplyScalar(far)
      .add(TARGET);
    this.camera.lookAt(TARGET);
    this.changed();
  }
}
