export interface Choice {
  readonly type: string;
  readonly name: string;
  readonly group: string;
  readonly text: string;
}

/** Choice of a Sum that subtracts. */
export const SUBTRACT = "subtract";

/** Return the choices that contain every word of `query`, the best first. */
export function searched<T extends Choice>(choices: readonly T[], query: string): T[] {
  const asked = plain(query);
  if (asked === "") return [...choices];
  const rated = choices.map((choice, i) => ({ choice, i, rank: Math.min(also(choice, asked), rank(choice, asked)) }));
  return rated
    .filter((one) => one.rank < NONE)
    .sort((a, b) => a.rank - b.rank || a.i - b.i)
    .map((one) => one.choice);
}

const NONE = 100;
/** Simulink's names of blocks. */
const ALSO: ReadonlyMap<string, readonly string[]> = new Map(
  Object.entries({
    sum: ["add"],
    [SUBTRACT]: ["minus", "difference"],
    saturation: ["saturate", "limiter"],
    pid: ["antiwindup"],
    rate_limit: ["rate limiter", "slew rate"],
    quantiser: ["quantizer"],
    lookup: ["lookup table", "look up table", "1 d lookup table", "table lookup"],
    lookup_2d: ["lookup table", "2 d lookup table"],
    unit_delay: ["memory"],
    fractional_delay: ["transport delay"],
    variable_delay: ["variable integer delay", "variable transport delay"],
    transfer_function: ["transfer fcn", "tf"],
    discrete_transfer_function: ["discrete transfer fcn", "transfer fcn"],
    state_space: ["ss", "lqr"],
    discrete_integrator: ["discrete time integrator"],
    discrete_derivative: ["derivative"],
    logic: ["logical operator", "and", "or", "not"],
    compare: ["relational operator"],
    multiport_switch: ["multi port switch"],
    convert: ["data type conversion", "cast"],
    elementary: ["math function", "exp", "log", "square", "sqrt"],
    minimum: ["minmax", "min max"],
    maximum: ["minmax", "min max"],
    rounding: ["rounding function", "floor", "ceil"],
    bitwise: ["bitwise operator"],
    data_store: ["data store memory"],
    store_read: ["data store read"],
    store_write: ["data store write"],
    first_true: ["if"],
    case_choice: ["switch case"],
    concatenate: ["vector concatenate"],
    bus_create: ["bus creator"],
    bus_select: ["bus selector"],
    bus_assign: ["bus assignment"],
    noise: ["random number", "band limited white noise"],
    uniform_noise: ["uniform random number"],
    sine: ["sine wave", "sin"],
    sweep: ["chirp signal"],
    pulse: ["pulse generator"],
    table: ["from workspace", "repeating sequence", "signal builder"],
    playback: ["from workspace"],
    constant: ["ground"],
    clock: ["digital clock"],
    input: ["inport", "in1"],
    output: ["outport", "out1"],
    diagram: ["subsystem", "enabled subsystem"],
    state_machine: ["stateflow", "chart"],
  }),
);

/** Replacements of Simulink's blocks that do not exist here. */
const INSTEAD: readonly (readonly [words: readonly string[], instead: string])[] = [
  [
    ["scope", "display", "to workspace", "floating scope"],
    "A scope is not a block here: select a wire or a block and press S.",
  ],
  [["goto", "from", "goto tag"], "A wire needs no Goto: connect the source with each reader (C)."],
  [["feedforward", "feed forward"], "A feed-forward is a Gain or a DiscreteDerivative, added with a Sum."],
  [["terminator"], "An output that nobody reads needs no Terminator."],
  [
    ["matlab function", "s function", "fcn", "interpreted matlab function"],
    "A block of your own is written in Python (How to, “Add a block”), and comes here with its diagram.",
  ],
];

const plain = (text: string): string =>
  text
    .toLowerCase()
    .split(/[^a-z0-9]+/)
    .filter(Boolean)
    .join(" ");

/** Return the replacement of a Simulink block, or "". */
export function instead(query: string): string {
  const asked = plain(query);
  if (asked.length < 3) return "";
  const begun = INSTEAD.find(([names]) =>
    names.some((name) => name === asked || (asked.length > 4 && name.startsWith(asked))),
  );
  return begun?.[1] ?? "";
}

function also({ type }: Choice, asked: string): number {
  const names = ALSO.get(type) ?? [];
  if (names.includes(asked)) return 0;
  return names.some((name) => asked.length > 2 && name.startsWith(asked)) ? 1 : NONE;
}

function rank(choice: Choice, asked: string): number {
  const name = choice.name.toLowerCase();
  const type = choice.type.replace(/_/g, " ");
  if (asked === name || asked === type) return 0;
  let worst = 0;
  for (const word of asked.split(" ")) {
    if (name === word || type === word) continue;
    if (name.startsWith(word) || type.startsWith(word)) worst = Math.max(worst, 1);
    else if (name.includes(word) || type.includes(word)) worst = Math.max(worst, 2);
    else if (choice.group.startsWith(word)) worst = Math.max(worst, 3);
    else if (choice.text.toLowerCase().includes(word)) worst = Math.max(worst, 4);
    else return NONE;
  }
  return worst;
}
