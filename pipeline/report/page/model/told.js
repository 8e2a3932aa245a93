import { frames } from "./frames.js";
import { plan } from "./plan.js";

// Report data below the picture: warnings, tables, frames, texts.

/** Show the report data in an element; no text is interpreted as HTML. */
export function tell(place, { warnings = [], tables = [], texts = [], cameras = [], frames: sentence = "", unit = "m" }) {
  if (!warnings.length && !tables.length && !texts.length && !cameras.length) return;
  document.body.classList.add("told");
  if (warnings.length) {
    place.append(heading("Warnings"));
    for (const text of warnings) place.append(element("p", text, "warning"));
  }
  for (const { title, head, rows, places } of tables) {
    place.append(heading(title), table(head, rows, places));
  }
  if (cameras.length) {
    const chosen = (number) => {
      window.scanloom.showPhoto(number);
      document.getElementById("picture").scrollIntoView({ block: "nearest" });
    };
    place.append(heading("Frames"));
    if (sentence) place.append(element("p", sentence));
    if (cameras.some(({ photo }) => photo)) place.append(frames(cameras, chosen));
    place.append(heading("Cameras from above"), plan(cameras, chosen, unit));
  }
  for (const { title, text } of texts) {
    place.append(folded(title, text));
  }
}

/** Create a collapsible text with a button that copies it. */
function folded(title, text) {
  const made = document.createElement("details");
  const written = element("pre", text);
  written.tabIndex = 0;
  written.setAttribute("aria-label", title);
  const copy = element("button", "copy");
  copy.type = "button";
  copy.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(text);
      copy.textContent = "copied";
    } catch {
      // Without clipboard access, select the text for manual copying.
      getSelection().selectAllChildren(written);
      written.focus();
    }
  });
  made.append(element("summary", title), copy, written);
  return made;
}

function table(head, rows, places) {
  const made = document.createElement("table");
  if (head.some((name) => name)) {
    const top = made.createTHead().insertRow();
    for (const [column, name] of head.entries()) {
      const cell = element(name ? "th" : "td", name);
      // Align headings with their column.
      if (rows.length && rows.every((row) => isNumber(row[column]))) cell.className = "number";
      if (name) cell.scope = "col";
      top.append(cell);
    }
  }
  const body = made.createTBody();
  rows.forEach((row, number) => {
    const line = body.insertRow();
    for (const [column, value] of row.entries()) {
      // Without a column heading, the first column contains row headings.
      const cell = column === 0 && !head[0] ? document.createElement("th") : line.insertCell();
      if (cell.tagName === "TH") {
        cell.scope = "row";
        line.append(cell);
      }
      cell.textContent = value;
      if (isNumber(value)) cell.className = "number";
    }
    if (places) line.insertCell().append(flight(places[number]));
  });
  const wide = element("div", "", "wide");
  wide.append(made);
  return wide;
}

/** Create a button that moves the view to a location, or to a suggested viewpoint of it. */
function flight({ target, away, eye }) {
  const button = element("button", "fly there");
  button.type = "button";
  button.addEventListener("click", () => {
    if (eye) window.scanloom.look({ eye, target });
    else window.scanloom.flyTo(target, away);
    document.getElementById("picture").scrollIntoView({ block: "nearest" });
  });
  return button;
}

const isNumber = (value) => /^[+−-]?[\d.,]+( [^ ]+)?$/.test(value);

const heading = (text) => element("h2", text);

function element(kind, text, name = "") {
  const made = document.createElement(kind);
  made.textContent = text;
  if (name) made.className = name;
  return made;
}
