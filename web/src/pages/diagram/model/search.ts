/** What a palette offers. */
export interface Choice {
  readonly type: string;
  readonly name: string;
  readonly group: string;
  readonly text: string;
}

/** The choices that hold every word of `query`, the best first: by name's beginning, by name, by text. All for "". */
export function searched<T extends Choice>(choices: readonly T[], query: string): T[] {
  const words = query.toLowerCase().split(/\s+/).filter(Boolean);
  if (words.length === 0) return [...choices];
  const rated = choices.map((choice, i) => ({ choice, i, rank: rank(choice, words) }));
  return rated
    .filter((one) => one.rank < NONE)
    .sort((a, b) => a.rank - b.rank || a.i - b.i)
    .map((one) => one.choice);
}

const NONE = 100;
/** Words of Simulink for what has another name here. */
const ALSO: ReadonlyMap<string, string> = new Map([
  ["add", "sum"],
  ["subtract", "sum"],
  ["saturate", "saturation"],
  ["memory", "unit_delay"],
  ["inport", "input"],
  ["outport", "output"],
  ["subsystem", "diagram"],
]);

function rank(choice: Choice, words: readonly string[]): number {
  const name = choice.name.toLowerCase();
  const type = choice.type.replace(/_/g, " ");
  let worst = 0;
  for (const word of words) {
    if (name === word || type === word || ALSO.get(word) === choice.type) continue;
    if (name.startsWith(word) || type.startsWith(word)) worst = Math.max(worst, 1);
    else if (name.includes(word) || type.includes(word)) worst = Math.max(worst, 2);
    else if (choice.group.startsWith(word)) worst = Math.max(worst, 3);
    else if (choice.text.toLowerCase().includes(word)) worst = Math.max(worst, 4);
    else return NONE;
  }
  return worst;
}
