import { frames } from "./frames.js";
import { plan } from "./plan.js";

// What is told of a run below its picture: warnings first, then stages, then all else.

/** Fill an element with what the content holds; nothing of it is read as HTML. */
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

/** A text that unfolds, and can be copied. */
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
      // Where pages may not, a person can: it is all chosen.
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
      // A heading stands over what is below it.
      if (rows.length && rows.every((row) => isNumber(row[column]))) cell.className = "number";
      if (name) cell.scope = "col";
      top.append(cell);
    }
  }
  const body = made.createTBody();
  rows.forEach((row, number) => {
    const line = body.insertRow();
    for (const [column, value] of row.entries()) {
      // What has no heading above it is named by what stands before it.
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

/** A button that brings the camera to a place, or to where one should look at it from. */
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
