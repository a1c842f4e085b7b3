// The scene alone: `?x=0.2&theta=0.3&ghost=1&rings=1`, or `?move=1` for a drone that never rests.
import { mount } from "svelte";
import "../src/design/tokens.css";
import "../src/design/base.css";
import MovingScene from "./MovingScene.svelte";

const asked = new URLSearchParams(location.search);
mount(MovingScene, { target: document.getElementById("app")!, props: { asked } });
