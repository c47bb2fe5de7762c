// Colours and dashes of methods: those of the figures, so that a method has one colour everywhere.

import { data } from "viewer/data.js";

/** The looks of methods, {colour, dash} by name; the dark scheme lightens them. */
export function looks(methods) {
  return new Map(
    methods.map((name) => {
      const { colour, dash } = data.looks[name] ?? { colour: "#8A8A8A", dash: "" };
      return [name, { colour: `color-mix(in srgb, ${colour}, white var(--lift))`, dash }];
    }),
  );
}
