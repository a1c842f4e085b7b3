import { Color, MeshBasicMaterial, MeshLambertMaterial, MeshPhongMaterial } from "three";
import { colour } from "../../chart/draw/canvas";

/** Materials of the scene by the token of their colour; `paint` applies the theme. */
export class Materials {
  readonly metal = new MeshLambertMaterial({ name: "metal" });
  readonly steel = new MeshPhongMaterial({ name: "steel", shininess: 60 });
  readonly plate = new MeshLambertMaterial({ name: "plate" });
  readonly carbon = new MeshLambertMaterial({ name: "carbon" });
  readonly guard = new MeshLambertMaterial({ name: "guard" });
  readonly rubber = new MeshLambertMaterial({ name: "bad" });
  readonly ring = new MeshLambertMaterial({ name: "warn" });
  readonly nose = new MeshLambertMaterial({ name: "estimate" });
  readonly thrust = new MeshBasicMaterial({ name: "input" });
  readonly disc = new MeshBasicMaterial({ name: "input", transparent: true, opacity: 0.2, depthWrite: false, side: 2 });
  readonly blade = new MeshBasicMaterial({ name: "input", transparent: true, opacity: 0.55, side: 2 });
  readonly wanted = new MeshBasicMaterial({ name: "set-point" });
  readonly ghost = new MeshBasicMaterial({ name: "truth", transparent: true, opacity: 0.32, depthWrite: false });
  readonly scale = new MeshBasicMaterial({ name: "soft" });
  readonly limit = new MeshBasicMaterial({ transparent: true, opacity: 0.38, depthWrite: false, side: 2 });
  readonly limitEdge = new MeshBasicMaterial();
  readonly beam = new MeshBasicMaterial({ name: "bad", transparent: true, opacity: 0.45 });
  private readonly all = Object.values(this) as (MeshBasicMaterial | MeshLambertMaterial | MeshPhongMaterial)[];
  dark = false;

  constructor() {
    this.warn(false);
  }

  paint(): void {
    const page = new Color(colour("page"));
    this.dark = page.r + page.g + page.b < 1;
    for (const material of this.all) material.color.set(colour(material.name));
  }

  /** Show the pitch limits as near, or as far. */
  warn(near: boolean): void {
    for (const limit of [this.limit, this.limitEdge]) {
      limit.name = near ? "bad" : "soft";
      limit.color.set(colour(limit.name));
    }
  }

  dispose(): void {
    for (const material of this.all) material.dispose();
  }
}
