// Elements of HTML and SVG, made in one call.

function make(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value != null) element.setAttribute(name, value);
  }
  element.append(...children.flat(Infinity).filter((child) => child != null));
  return element;
}

/** An element of HTML; attributes that begin with "on" are listeners. */
export function h(tag, attributes = {}, ...children) {
  return make(document.createElement(tag), attributes, children);
}

/** An element of SVG. */
export function s(tag, attributes = {}, ...children) {
  return make(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children);
}

/** A labelled <select> of [value, text] pairs; `read` gives the value, `write` gets the new one. */
export function select(label, choices, read, write) {
  const input = h("select", { "aria-label": label, onchange: () => write(input.value) });
  const update = () => {
    const pairs = choices();
    input.replaceChildren(...pairs.map(([value, text]) => h("option", { value }, text)));
    input.value = String(read());
  };
  update();
  return { element: h("label", { class: "field" }, h("span", {}, label), input), update, input };
}

/** A labelled slider with its value as text. */
export function slider(label, bounds, read, write, text) {
  const output = h("output");
  const input = h("input", {
    type: "range",
    "aria-label": label,
    ...bounds,
    oninput: () => write(Number(input.value)),
  });
  const update = () => {
    input.value = read();
    output.textContent = text(read());
    input.setAttribute("aria-valuetext", output.textContent);
  };
  update();
  return {
    element: h("label", { class: "field slider" }, h("span", {}, label), input, output),
    update,
    input,
  };
}

/** A number with few digits. */
export function short(value, digits = 3) {
  if (value === null || Number.isNaN(value)) return "–";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "-∞";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-3 || size >= 1e5)) return value.toExponential(1);
  return String(Number(value.toPrecision(digits)));
}
