// Map of the camera positions, seen from above.
const SVG = "http://www.w3.org/2000/svg";
const SIZE = 360;
const ROOM = 14;

/** Create an SVG map of the camera path; cameras with a photo are buttons. */
export function plan(cameras, chosen, unit) {
  const places = cameras.map(({ pose }) => [pose[3], -pose[7]]);
  const [low, high] = [Math.min, Math.max].map((least) => [0, 1].map((axis) => least(...places.map((place) => place[axis]))));
  const span = Math.max(high[0] - low[0], high[1] - low[1], 1e-9);
  const scale = (SIZE - 2 * ROOM) / span;
  const points = places.map((place) => place.map((value, axis) => ROOM + (value - low[axis]) * scale));
  const size = [0, 1].map((axis) => 2 * ROOM + (high[axis] - low[axis]) * scale);
  const drawing = made("svg", { viewBox: `0 0 ${size[0]} ${size[1]}`, class: "plan" });
  drawing.setAttribute("aria-label", `Path of ${cameras.length} cameras from above, ${span.toPrecision(2)} ${unit} across`);
  // Held-out frames are last in the list instead of in order of time, so the path excludes them.
  const way = points.filter((_, number) => cameras[number].mark !== "held out");
  drawing.append(made("polyline", { points: way.map((point) => point.map((value) => value.toFixed(1)).join(",")).join(" ") }));
  cameras.forEach(({ frame, photo, mark = "" }, number) => {
    const [cx, cy] = points[number];
    const marked = mark ? { class: "marked" } : {};
    if (!photo) return drawing.append(made("circle", { cx, cy, r: mark ? 3 : 1.6, ...marked }));
    const label = `Photo of frame ${frame}${mark ? `, ${mark}` : ""}`;
    const button = made("circle", { cx, cy, r: 5, tabindex: 0, role: "button", "aria-label": label, ...marked });
    const title = made("title", {});
    title.textContent = `frame ${frame}${mark ? `: ${mark}` : ""}`;
    button.append(title);
    const choose = () => chosen(number);
    button.addEventListener("click", choose);
    button.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      choose();
    });
    drawing.append(button);
  });
  return drawing;
}

function made(kind, attributes) {
  const element = document.createElementNS(SVG, kind);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}
