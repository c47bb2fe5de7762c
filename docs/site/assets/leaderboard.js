// The leaderboard of a preset: the table of the viewer, in a page of the documentation.

const board = document.querySelector(".leaderboard");
const response = await fetch(new URL(board.dataset.source, document.baseURI));
if (!response.ok) throw new Error(`${response.url}: ${response.status}`);

// viewer/data.js reads this element when it is first imported
const element = document.createElement("script");
Object.assign(element, { type: "application/json", id: "data", textContent: await response.text() });
document.body.append(element);

const { tableView } = await import("viewer/table_view.js");
const { start, subscribe } = await import("viewer/state.js");
start({ view: "table", tspp: defaultBudget(JSON.parse(element.textContent)) });
const view = tableView();
view.update();
subscribe(view.update);
board.replaceChildren(view.element);
board.dataset.ready = "";

/** 1 spp where it was measured, else all budgets. */
function defaultBudget(data) {
  const records = data.devices[0].table.metrics[0]?.records ?? [];
  return records.some((each) => each.target_spp === 1) ? "1" : "";
}
