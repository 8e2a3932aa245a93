// The controls below the picture.
const WHOLE = new Intl.NumberFormat("en");

/** Tie the controls of a form to a picture of several models. */
export function bar(form, drawn, models) {
  const { model, mode, measure, all } = form.elements;
  const figures = form.querySelector("#figures");
  models.forEach(({ name }, number) => model.add(new Option(name, number)));
  model.closest("label").hidden = models.length < 2;

  model.addEventListener("change", () => drawn.show(Number(model.value)));
  mode.addEventListener("change", () => drawn.set({ mode: mode.value }));
  measure.addEventListener("click", () => drawn.set({ measuring: !drawn.settings().measuring }));
  all.addEventListener("click", () => drawn.showAll());
  form.addEventListener("submit", (event) => event.preventDefault());
  addEventListener("keydown", (event) => {
    const number = Number.parseInt(event.key, 10) - 1;
    const typing = /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName ?? "");
    if (!typing && !event.ctrlKey && !event.metaKey && !event.altKey && number in models) drawn.show(number);
  });
  drawn.onChange(() => {
    const settings = drawn.settings();
    model.value = settings.model;
    mode.value = settings.mode;
    measure.setAttribute("aria-pressed", String(settings.measuring));
    figures.textContent = sentence(settings, models[settings.model], drawn);
  });
}

function sentence(settings, { triangles, note }, drawn) {
  const distance = drawn.distance();
  if (distance !== null) return `${distance.toPrecision(4)} m between the two points`;
  if (settings.measuring) return drawn.points().length ? "Now the second point." : "Click two points of the surface.";
  return `${WHOLE.format(triangles)} triangles${note ? ` · ${note}` : ""}`;
}
