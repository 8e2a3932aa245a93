// Controls below the picture.
const WHOLE = new Intl.NumberFormat("en");
const NONE = "none";

/** Connect the controls of a form to the picture of the models and cameras. */
export function bar(form, drawn, models, cameras, unit) {
  const { model, beside, mode, cut, at, cameras: shown, photo, opacity, safe, measure, all } = form.elements;
  const metrics = form.querySelector("#metrics");
  models.forEach(({ name }, number) => {
    model.add(new Option(name, number));
    beside.add(new Option(name, number));
  });
  cameras.forEach(({ frame, photo: image }, number) => image && photo.add(new Option(frame, number)));
  hide(models.length < 2, model, beside);
  hide(!cameras.length, shown);
  hide(photo.options.length < 2, photo);

  const numbered = ({ value }) => (value === NONE ? null : Number(value));
  model.addEventListener("change", () => drawn.show(Number(model.value)));
  beside.addEventListener("change", () => drawn.showBeside(numbered(beside)));
  mode.addEventListener("change", () => drawn.set({ mode: mode.value }));
  cut.addEventListener("change", () => drawn.set({ cut: cut.value }));
  at.addEventListener("input", () => drawn.set({ at: Number(at.value) }));
  shown.addEventListener("change", () => drawn.set({ cameras: shown.checked }));
  photo.addEventListener("change", () => drawn.showPhoto(numbered(photo)));
  opacity.addEventListener("input", () => drawn.set({ opacity: Number(opacity.value) }));
  safe.addEventListener("change", () => drawn.set({ safe: safe.checked }));
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
    beside.value = settings.beside ?? NONE;
    mode.value = settings.mode;
    cut.value = settings.cut;
    shown.checked = settings.cameras;
    photo.value = settings.photo ?? NONE;
    safe.checked = settings.safe;
    hide(![settings.model, settings.beside].some((number) => models[number]?.scale?.safe), safe);
    hide(settings.cut === NONE, at);
    hide(settings.photo === null, opacity);
    measure.setAttribute("aria-pressed", String(settings.measuring));
    metrics.textContent = sentence(settings, models, drawn, unit);
  });
}

function hide(isHidden, ...controls) {
  for (const control of controls) control.closest("label").hidden = isHidden;
}

function sentence({ model, beside, measuring }, models, drawn, unit) {
  const distance = drawn.distance();
  if (distance !== null) return `${distance.toPrecision(4)} ${unit} between the two points`;
  if (measuring) return drawn.points().length ? "Now the second point." : "Click two points of the surface.";
  const { triangles, note } = models[model];
  const words = `${WHOLE.format(triangles)} triangles${note ? ` · ${note}` : ""}`;
  return beside === null || beside === model ? words : `left ${models[beside].name}, right ${models[model].name}: ${words}`;
}
