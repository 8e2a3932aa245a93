// Report data below the picture: warnings, tables, frames, texts.
import { frames } from "./frames.js";
import { plan } from "./plan.js";
import { copyText } from "./saving.js";

const MOST_COLUMNS = 4; // of a table next to another

/** Show the report data in an element; no text is interpreted as HTML. */
export function fillReport(place, { warnings = [], tables = [], texts = [], cameras = [], frames: sentence = "", unit = "m" }) {
  if (!warnings.length && !tables.length && !texts.length && !cameras.length) return;
  document.body.classList.add("continued");
  if (warnings.length) {
    place.append(Object.assign(heading("Warnings"), { id: "warnings" }));
    for (const text of warnings) place.append(element("p", text, "warning"));
  }
  const columns = element("div", "", "columns");
  for (const { title, text, head, rows, places } of tables.filter(({ folded }) => !folded)) {
    const section = element("section", "");
    // Long tables need the full width.
    if (head.length > MOST_COLUMNS) section.style.gridColumn = "1 / -1";
    section.append(heading(title));
    if (text) section.append(element("p", text));
    section.append(table(head, rows, places));
    columns.append(section);
  }
  if (columns.children.length) place.append(columns);
  if (cameras.length) {
    const chosen = (number) => {
      window.scanloom.showPhoto(number);
      document.getElementById("stage").scrollIntoView({ block: "nearest" });
    };
    place.append(heading("Photos"));
    if (sentence) place.append(element("p", sentence));
    if (cameras.some(({ photo }) => photo)) place.append(frames(cameras, chosen));
    place.append(heading("Cameras from above"), plan(cameras, chosen, unit));
  }
  const folded = [
    ...tables.filter((one) => one.folded).map(({ title, text, head, rows, places }) => foldTable(title, text, table(head, rows, places))),
    ...texts.map(({ title, text }) => foldText(title, text)),
  ];
  if (folded.length) place.append(heading("Details"), ...folded);
}

function foldTable(title, text, shown) {
  const made = document.createElement("details");
  made.append(element("summary", title));
  if (text) made.append(element("p", text));
  made.append(shown);
  return made;
}

/** Create a collapsible text with a button that copies it. */
function foldText(title, text) {
  const made = document.createElement("details");
  const written = element("pre", text);
  written.tabIndex = 0;
  written.setAttribute("aria-label", title);
  const copy = element("button", "Copy");
  copy.type = "button";
  copy.addEventListener("click", () => copyText(text, written, copy));
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
  const button = element("button", "Show");
  button.type = "button";
  button.addEventListener("click", () => {
    if (eye) window.scanloom.look({ eye, target });
    else window.scanloom.flyTo(target, away);
    document.getElementById("stage").scrollIntoView({ block: "nearest" });
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
