import { Color, MeshBasicMaterial, MeshLambertMaterial, MeshPhongMaterial, type ColorRepresentation } from "three";
import { colour } from "../../chart/draw/canvas";

const THINGS = {
  light: {
    metal: "#c3c8cf",
    steel: "#e7eaee",
    plate: "#3c424c",
    carbon: "#23272e",
    guard: "#8a919c",
    rubber: "#b3261e",
  },
  dark: {
    metal: "#6f7783",
    steel: "#b9c0ca",
    plate: "#9aa2ae",
    carbon: "#c9ced6",
    guard: "#7d8591",
    rubber: "#ff8a80",
  },
} as const;

/** Materials of the scene; `paint` applies the theme. */
export class Materials {
  readonly metal = new MeshLambertMaterial();
  readonly steel = new MeshPhongMaterial({ shininess: 60 });
  readonly plate = new MeshLambertMaterial();
  readonly carbon = new MeshLambertMaterial();
  readonly guard = new MeshLambertMaterial();
  readonly rubber = new MeshLambertMaterial();
  readonly ring = new MeshLambertMaterial();
  readonly nose = new MeshLambertMaterial();
  readonly thrust = new MeshBasicMaterial();
  readonly disc = new MeshBasicMaterial({ transparent: true, opacity: 0.2, depthWrite: false, side: 2 });
  readonly blade = new MeshBasicMaterial({ transparent: true, opacity: 0.55, side: 2 });
  readonly wanted = new MeshBasicMaterial();
  readonly ghost = new MeshBasicMaterial({ transparent: true, opacity: 0.32, depthWrite: false });
  readonly scale = new MeshBasicMaterial();
  readonly limit = new MeshBasicMaterial({ transparent: true, opacity: 0.38, depthWrite: false, side: 2 });
  readonly limitEdge = new MeshBasicMaterial();
  readonly beam = new MeshBasicMaterial({ transparent: true, opacity: 0.45 });
  dark = false;

  paint(): void {
    const page = new Color(colour("page"));
    this.dark = page.r + page.g + page.b < 1;
    const things = THINGS[this.dark ? "dark" : "light"];
    const give: [{ color: Color }, ColorRepresentation][] = [
      [this.metal, things.metal],
      [this.steel, things.steel],
      [this.plate, things.plate],
      [this.carbon, things.carbon],
      [this.guard, things.guard],
      [this.rubber, things.rubber],
      [this.ring, colour("warn")],
      [this.nose, colour("estimate")],
      [this.thrust, colour("input")],
      [this.disc, colour("input")],
      [this.blade, colour("input")],
      [this.wanted, colour("set-point")],
      [this.ghost, colour("truth")],
      [this.scale, colour("soft")],
      [this.limit, colour("soft")],
      [this.limitEdge, colour("soft")],
      [this.beam, colour("bad")],
    ];
    for (const [material, value] of give) material.color.set(value);
  }

  warn(near: boolean): void {
    const now = colour(near ? "bad" : "soft");
    this.limit.color.set(now);
    this.limitEdge.color.set(now);
  }

  dispose(): void {
    for (const one of Object.values(this))
      if (one instanceof MeshBasicMaterial || one instanceof MeshLambertMaterial || one instanceof MeshPhongMaterial)
        one.dispose();
  }
}
