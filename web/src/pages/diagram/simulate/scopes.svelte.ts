// Scopes: wires whose signals are shown. A scope stands on what gives the signal, so it stays when wires change.
import { SERIES } from "../../../chart/kinds";
import { editor } from "../editor.svelte";
import { wiresOf } from "../model/diagram";
import { originOf, type Origin } from "../model/signals";

export interface Scope extends Origin {
  readonly colour: string;
}

const MOST = SERIES.length;
const key = (origin: Origin): string => `${origin.of} ${origin.path}`;

class Scopes {
  all = $state.raw<readonly Scope[]>([]);

  readonly byWire: ReadonlyMap<string, string> = $derived.by(() => {
    const found = new Map<string, string>();
    if (this.all.length === 0) return found;
    const colours = new Map(this.all.map((scope) => [key(scope), scope.colour]));
    for (const [source, to] of wiresOf(editor.here)) {
      const origin = originOf(editor.root, editor.path, source, editor.shapes);
      const colour = origin === undefined ? undefined : colours.get(key(origin));
      if (colour !== undefined) found.set(to, colour);
    }
    return found;
  });

  toggle(source: string): void {
    const origin = originOf(editor.root, editor.path, source, editor.shapes);
    if (origin === undefined) return editor.say("this wire carries no signal yet");
    const there = this.all.filter((one) => key(one) !== key(origin));
    if (there.length < this.all.length) {
      this.all = there;
      return editor.say(`${origin.path} is hidden`);
    }
    if (there.length >= MOST) return editor.say(`${MOST} signals are shown: hide one first`);
    const used = new Set(there.map((one) => one.colour));
    const colour = SERIES.find((one) => !used.has(one)) ?? SERIES[0]!;
    this.all = [...there, { ...origin, colour }];
    editor.say(`${origin.path} is on the scope`);
  }

  remove(scope: Scope): void {
    this.all = this.all.filter((one) => one !== scope);
  }

  clear(): void {
    this.all = [];
  }
}

export const scopes = new Scopes();
