// Colours and dashes of methods, alike in all views as far as colours go round.

import { data } from "viewer/data.js";

const COUNT = 8; // --method-0 ... in style.css
const DASHES = ["", "6 3", "2 3", "8 3 2 3"];
const order = new Map();

/** The looks of methods that are shown together, {colour, dash} by name. Each has its own colour
 * wherever it is free, and a colour that is taken comes with another dash. */
export function looks(methods) {
  if (!order.size) ranking().forEach((name, index) => order.set(name, index));
  const taken = [];
  const found = new Map();
  for (const name of methods) {
    const own = (order.get(name) ?? order.size) % COUNT;
    const least = Math.min(...Array.from({ length: COUNT }, (_, i) => taken[i] ?? 0));
    let index = own;
    while ((taken[index] ?? 0) > least) index = (index + 1) % COUNT;
    taken[index] = (taken[index] ?? 0) + 1;
    found.set(name, {
      colour: `var(--method-${index})`,
      dash: DASHES[(taken[index] - 1) % DASHES.length],
    });
  }
  return found;
}

/** All methods, the best mean score at the smallest distance to 1 spp first. */
function ranking() {
  const records = data.devices.flatMap(({ table }) => table.metrics[0]?.records ?? []);
  const sign = data.devices[0]?.table.metrics[0]?.direction === "lower" ? 1 : -1;
  const near = (record) => Math.abs(Math.log(Math.max(record.target_spp, 1e-9)));
  const best = new Map();
  for (const record of records) {
    const known = best.get(record.method);
    if (!known || near(record) < near(known)) best.set(record.method, record);
  }
  return [...best.values()].sort((a, b) => sign * (a.mean - b.mean)).map((record) => record.method);
}
