// Panel of the measurements: kind, prompt, list, and export.
import { saveFile } from "./saving.js";

/** Connect the panel to the picture and its measurements. */
export function connectPanel(panel, drawn, measurements, title) {
  const [kinds, prompt, finish, list, save] = ["#kinds", "#prompt", "#finish", "#entries", "#export"].map((id) => panel.querySelector(id));
  const rows = new Map();
  for (const [key, name] of measurements.kinds) {
    const button = create("button", name);
    button.dataset.kind = key;
    button.addEventListener("click", () => measurements.choose(key));
    kinds.append(button);
  }
  finish.addEventListener("click", () => measurements.finish());
  save.addEventListener("click", () => saveFile(`${JSON.stringify({ title, ...drawn.annotations() }, null, 1)}\n`, "application/json", "json"));

  function createRow(entry) {
    const row = document.createElement("li");
    const value = create("button", [measurements.nameOf(entry), measurements.format(entry)].filter(Boolean).join(" "));
    value.className = "value";
    value.title = "Move the view there";
    value.addEventListener("click", () => drawn.center(measurements.middleOf(entry)));
    const remove = create("button", "×");
    remove.setAttribute("aria-label", `Delete ${value.textContent}`);
    remove.addEventListener("click", () => measurements.remove(entry));
    const text = document.createElement("input");
    text.className = "text";
    text.placeholder = "Text";
    text.setAttribute("aria-label", `Text of ${value.textContent}`);
    text.addEventListener("input", () => measurements.annotate(entry, text.value));
    row.append(value, remove, text);
    return { row, text };
  }

  drawn.onChange(() => {
    panel.hidden = !drawn.settings().measuring;
    for (const button of kinds.children) button.setAttribute("aria-pressed", String(button.dataset.kind === measurements.kind()));
    prompt.textContent = measurements.prompt();
    finish.hidden = !measurements.canFinish();
    save.disabled = !measurements.entries.length;
    for (const [entry, { row }] of rows) {
      if (measurements.entries.includes(entry)) continue;
      row.remove();
      rows.delete(entry);
    }
    for (const entry of measurements.entries) {
      if (rows.has(entry)) continue;
      const made = createRow(entry);
      rows.set(entry, made);
      list.append(made.row);
      // The panel scrolls, not the page: the reader is about to click the model.
      panel.scrollTop = panel.scrollHeight;
      if (entry.kind === "note") made.text.focus({ preventScroll: true });
    }
  });
}

function create(kind, text) {
  const element = document.createElement(kind);
  element.textContent = text;
  element.type = "button";
  return element;
}
