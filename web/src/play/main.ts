import { mount } from "svelte";
import "../design/tokens.css";
import "../design/base.css";
import { embedded } from "./data";
import { Flight } from "./flight";
import { Pilot } from "./pilot.svelte";
import PlayPage from "./PlayPage.svelte";

const target = document.getElementById("app")!;
const { module, data } = embedded();
Flight.load(module, data).then(
  (flight) => {
    const pilot = new Pilot(flight);
    mount(PlayPage, { target, props: { pilot } });
    Object.assign(globalThis, { pilot }); // for who wants to fly from the console
  },
  (reason: unknown) => {
    target.textContent = `The flight code could not be started: ${String(reason)}. Use a browser of this decade.`;
  },
);
