// The numbers of the page.

export const data = JSON.parse(document.getElementById("data").textContent);

/** Does the page show image files alone, without results, references and budgets? */
export const isGallery = !data.devices.length;

/** The 256 colours of the map of a layer, RGB bytes. */
export const maps = Object.fromEntries(
  Object.entries(data.maps).map(([name, text]) => [
    name,
    Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)),
  ]),
);
