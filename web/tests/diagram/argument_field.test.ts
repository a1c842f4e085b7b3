// The field of an argument: a list where it is one of some words, else what one types.
import { render } from "svelte/server";
import { expect, test } from "vitest";
import ArgumentField from "../../src/pages/diagram/panels/ArgumentField.svelte";

const drawn = (value: string, choices?: readonly string[]): string =>
  render(ArgumentField, {
    props: { label: "signs", value, onchange: () => undefined, ...(choices && { choices }) },
  }).body;

test("a text of no fixed words is typed: the signs of a sum, the unit of a port", () => {
  for (const field of [drawn("++"), drawn("++", [])]) {
    expect(field).toContain('type="text"');
    expect(field).toContain('value="++"');
    expect(field).not.toContain("<select");
  }
});

test("one of some words is chosen, and a word that is none of them stays to be seen", () => {
  const field = drawn("odd", ["none", "all"]);
  expect(field.match(/<option/g)).toHaveLength(3);
  expect(field).toContain("odd</option>");
});
