// Colours and dashes of methods: equal in all views, and told apart without colour by dash and label.

import { data } from "viewer/data.js";

const COUNT = 8; // --method-0 ... in style.css
const order = new Map();

/** The look of a method: a CSS colour and a dash pattern. */
export function look(method) {
  if (!order.size) ranking().forEach((name, index) => order.set(name, index));
  const index = order.get(method) ?? order.size;
  const dash = ["", "6 3", "2 3", "8 3 2 3"][Math.floor(index / COUNT) % 4];
  return { colour: method === "reference" ? "var(--ink)" : `var(--method-${index % COUNT})`, dash };
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
