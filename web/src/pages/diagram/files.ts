// Files of this computer that the page opens: a diagram's JSON, or a Simulink model with what belongs to it.
import { canonical } from "../../api/diagrams";

const MOST = 8 * 2 ** 20;
export const ACCEPTED = ".json,application/json,.slx,.mdl,.m,.mat";

export const isModel = (file: File): boolean => /\.(slx|mdl)$/i.test(file.name);

/** Read the JSON of a diagram. Raises an Error that says what is wrong with the file. */
export async function diagramText(file: File): Promise<string> {
  if (file.size > MOST) throw new Error(`${file.name} is larger than a diagram may be (8 MiB)`);
  const text = await file.text();
  if (!/^\s*\{/.test(text))
    throw new Error(`${file.name} is not a diagram: give a JSON file that Save or Python wrote, or a Simulink model`);
  return canonical(text);
}
