import { CanvasTexture, Sprite, SpriteMaterial } from "three";
import { colour } from "../../chart/draw/canvas";

const PIXELS = 48;

/** Text that faces the viewer, in the colour of the theme. */
export class Label {
  readonly sprite: Sprite;
  private readonly canvas = document.createElement("canvas");
  private readonly texture: CanvasTexture;

  constructor(
    private readonly text: string,
    height: number,
    [x, y, z]: readonly [number, number, number],
    private readonly token = "soft",
  ) {
    const ctx = this.canvas.getContext("2d")!;
    ctx.font = this.font;
    this.canvas.width = Math.ceil(ctx.measureText(text).width) + 8;
    this.canvas.height = Math.ceil(PIXELS * 1.3);
    this.texture = new CanvasTexture(this.canvas);
    this.sprite = new Sprite(new SpriteMaterial({ map: this.texture, transparent: true, depthWrite: false }));
    this.sprite.scale.set((height * this.canvas.width) / this.canvas.height, height, 1);
    this.sprite.position.set(x, y, z);
    this.paint();
  }

  paint(): void {
    const ctx = this.canvas.getContext("2d")!;
    ctx.clearRect(0, 0, this.canvas.width, this.canvas.height);
    ctx.font = this.font;
    ctx.textBaseline = "middle";
    ctx.textAlign = "center";
    ctx.fillStyle = colour(this.token);
    ctx.fillText(this.text, this.canvas.width / 2, this.canvas.height / 2);
    this.texture.needsUpdate = true;
  }

  dispose(): void {
    this.texture.dispose();
    this.sprite.material.dispose();
  }

  private get font(): string {
    return `500 ${PIXELS}px system-ui, "Noto Sans", "Liberation Sans", sans-serif`;
  }
}
