// Header of the page: title, picture, and the main facts of the result.

/** Fill the header; no text is interpreted as HTML. */
export function fillHeader({ title, header: { subtitle = "", facts = [], picture = null } = {} }) {
  document.title = title;
  document.getElementById("title").textContent = title;
  document.getElementById("subtitle").textContent = subtitle;
  const portrait = document.getElementById("portrait");
  if (picture) portrait.src = picture;
  portrait.hidden = !picture;
  document.getElementById("facts").append(...facts.map(createFact));
}

function createFact({ name, value, note = "", link = "" }) {
  const row = create("div");
  const shown = create("dd");
  if (link) {
    const anchor = create("a", value);
    anchor.href = `#${link}`;
    shown.append(anchor);
    row.className = "alert";
  } else shown.textContent = value;
  row.append(create("dt", name), shown);
  if (note) row.append(Object.assign(create("dd", note), { className: "note" }));
  return row;
}

function create(kind, text = "") {
  const element = document.createElement(kind);
  element.textContent = text;
  return element;
}
