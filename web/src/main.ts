import { mount } from "svelte";
import { takeToken } from "./api/client";
import App from "./app/App.svelte";
import "./design/tokens.css";
import "./design/base.css";

const target = document.getElementById("app");
if (target === null) throw new Error("the page has no element #app");
takeToken();
mount(App, { target });
