import { DirectionalLight, Group, HemisphereLight, type Mesh, PerspectiveCamera, Scene, WebGLRenderer } from "three";
import { askFrame, forgetFrame, onTheme } from "../../chart/draw/canvas";
import { BAR_HEIGHT, BEARING_HEIGHT, CART_HALF, DEPTH, PITCH_STOP, RANGE_FROM, SUPPORT_SIDE } from "../dimensions";
import type { Place, Pose, Wanted } from "../pose";
import { bench, cart, dropShadow, rings } from "./bench";
import { DroneBody, ghostBody } from "./drone";
import type { Label } from "./labels";
import { PitchLimits } from "./limits";
import { Materials } from "./materials";
import { Orbit } from "./orbit";
import { box, rodX } from "./shapes";

/** Distance to the stop [rad] at which the arc turns red. */
const NEAR = 0.12;
/** A nearer ghost is hidden [m]. */
const APART = 0.004;
/** Smallest change that is drawn [m or rad]: a third of a pixel, and more than the noise of a drone at rest. */
const SEEN = 0.002;
/** The same of a motor's command. */
const SEEN_COMMAND = 0.02;
/**
 * A processor that draws in place of a graphics card holds up the whole page while it does. It then draws at most each
 * SOFTWARE_WAIT [ms], and waits SHARE times as long as it has held the page up: charts and controls come first.
 */
const SOFTWARE_WAIT = 50;
const SHARE = 6;
const LONGEST_WAIT = 500;

/** Rig in three dimensions, drawn on changes only. */
export class RigWorld {
  drawn = 0;
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(26, 2, 0.1, 10);
  private readonly materials = new Materials();
  private readonly slide = new Group();
  private readonly drone: DroneBody;
  private readonly limits: PitchLimits;
  private readonly ghost: Group;
  private readonly rings: Group;
  private readonly wanted: Mesh;
  private readonly beam: Mesh;
  private readonly labels: Label[];
  private readonly key = new DirectionalLight(0xffffff, 2.2);
  private readonly sky = new HemisphereLight(0xffffff, 0x777777, 1.4);
  private readonly ends = new AbortController();
  private readonly software: boolean;
  /** What was drawn last. */
  private places: readonly (number | undefined)[] = [];
  private commands: readonly number[] = [];
  private last = -Infinity;
  private wait = SOFTWARE_WAIT;
  private readonly draw = (): void => {
    if (this.software) {
      const now = performance.now();
      if (now - this.last < this.wait) return this.ask();
      this.last = now;
      requestAnimationFrame(() => {
        // A frame takes 17 ms anyway; what is more was the drawing.
        const held = Math.max(0, performance.now() - now - 17);
        this.wait = Math.min(LONGEST_WAIT, Math.max(SOFTWARE_WAIT, 0.7 * this.wait + 0.3 * SHARE * held));
      });
    }
    this.renderer.render(this.scene, this.camera);
    this.drawn += 1;
  };

  /** Raises without WebGL. */
  constructor(
    canvas: HTMLCanvasElement,
    private readonly still: boolean,
  ) {
    this.software = drawnBySoftware();
    const antialias = !this.software; // four times the work
    this.renderer = new WebGLRenderer({ canvas, antialias, alpha: true, powerPreference: "low-power" });
    this.renderer.setPixelRatio(Math.min(2, devicePixelRatio));
    const { materials } = this;
    const frame = bench(materials);
    this.drone = new DroneBody(materials);
    this.drone.group.position.y = BEARING_HEIGHT;
    this.limits = new PitchLimits(materials, SUPPORT_SIDE + 0.012);
    this.limits.group.position.y = BEARING_HEIGHT;
    this.rings = rings(materials);
    this.ghost = ghostBody(materials.ghost);
    this.ghost.position.y = BEARING_HEIGHT;
    this.wanted = box(materials.wanted, [0.008, 0.002, 0.04], [0, 0.0015, DEPTH / 2 + 0.004]);
    this.beam = rodX(materials.beam, 0.0012, 1, 0, BAR_HEIGHT + 0.028, 0);
    this.slide.add(cart(materials), this.drone.group, this.limits.group, dropShadow(), pointer(materials));
    this.key.position.set(0.8, 1.6, 1.2);
    this.scene.add(frame.group, this.slide, this.ghost, this.rings, this.wanted, this.beam, this.key, this.sky);
    this.labels = [...frame.labels, ...this.limits.labels];
    const orbit = new Orbit(this.camera, () => this.ask());
    orbit.listen(canvas.parentElement ?? canvas, this.ends.signal);
    const sizes = new ResizeObserver(() => {
      const { clientWidth: width, clientHeight: height } = canvas;
      if (!width || !height) return;
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
      orbit.place();
    });
    sizes.observe(canvas);
    const endTheme = onTheme(() => this.paint());
    canvas.addEventListener("webglcontextrestored", () => this.ask(), { signal: this.ends.signal });
    this.ends.signal.addEventListener("abort", () => {
      endTheme();
      sizes.disconnect();
    });
    this.paint();
  }

  show(pose: Pose, ghost: Place | undefined, wanted: Wanted): void {
    const { x, theta } = pose;
    const places = [x, theta, ghost?.x, ghost?.theta, wanted.x, wanted.theta, pose.rings ? 1 : 0];
    const commands = [pose.fore, pose.aft];
    const turning = !this.still && commands.some((one) => one > 0.01);
    if (!turning && !moved(places, this.places, SEEN) && !moved(commands, this.commands, SEEN_COMMAND)) return;
    [this.places, this.commands] = [places, commands];
    this.slide.position.x = x;
    this.drone.group.rotation.z = theta;
    this.drone.thrust(pose.fore, pose.aft, !this.still);
    this.limits.show(theta, wanted.theta);
    this.materials.warn(Math.abs(theta) > PITCH_STOP - NEAR);
    this.rings.visible = pose.rings ?? false;
    this.rings.position.x = x;
    this.ghost.visible = ghost !== undefined && Math.hypot(ghost.x - x, 0.1 * (ghost.theta - theta)) > APART;
    if (ghost !== undefined) {
      this.ghost.position.x = ghost.x;
      this.ghost.rotation.z = ghost.theta;
    }
    this.wanted.visible = wanted.x !== undefined;
    this.wanted.position.x = wanted.x ?? 0;
    const length = x - CART_HALF - RANGE_FROM - 0.02;
    this.beam.scale.y = Math.max(0.001, length);
    this.beam.position.x = RANGE_FROM + 0.02 + length / 2;
    this.ask();
  }

  end(): void {
    this.ends.abort();
    forgetFrame(this.draw);
    this.scene.traverse((one) => (one as Partial<Mesh>).geometry?.dispose());
    for (const label of this.labels) label.dispose();
    this.materials.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }

  private ask(): void {
    askFrame(this.draw);
  }

  private paint(): void {
    this.materials.paint();
    for (const label of this.labels) label.paint();
    this.sky.intensity = this.materials.dark ? 1.1 : 1.5;
    this.key.intensity = this.materials.dark ? 1.9 : 2.1;
    this.ask();
  }
}

function moved(now: readonly (number | undefined)[], before: readonly (number | undefined)[], by: number): boolean {
  return now.some((one, k) => !(one === before[k] || Math.abs(one! - before[k]!) < by));
}

function drawnBySoftware(): boolean {
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = gl && info ? String(gl.getParameter(info.UNMASKED_RENDERER_WEBGL)) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

function pointer(materials: Materials): Mesh {
  return box(materials.nose, [0.007, 0.002, 0.026], [0, 0.002, DEPTH / 2 + 0.01]);
}
