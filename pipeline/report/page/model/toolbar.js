// Controls of the picture: menus and buttons below it, and buttons in its corner.
import { composePicture, saveFile } from "./saving.js";

const COUNT = new Intl.NumberFormat("en");
const NONE = "none";

/** Connect the controls of the page to the picture of the models and cameras. */
export function connectToolbar(drawn, { files, models, cameras = [] }) {
  const form = document.getElementById("bar");
  const { model, beside, mode, cut, at, photo, opacity, safe } = form.elements;
  const [stage, view, canvas, metrics, shown, measure, help, full] = ["stage", "view", "picture", "metrics", "cameras", "measure", "help", "full"].map((id) =>
    document.getElementById(id),
  );
  const onClick = (id, act) => document.getElementById(id).addEventListener("click", act);
  models.forEach(({ name }, number) => {
    model.add(new Option(name, number));
    beside.add(new Option(name, number));
  });
  cameras.forEach(({ frame, photo: image }, number) => image && photo.add(new Option(frame, number)));
  hide(models.length < 2, model, beside);
  hide(photo.options.length < 2, photo);
  shown.hidden = !cameras.length;
  full.hidden = !document.fullscreenEnabled;

  const numbered = ({ value }) => (value === NONE ? null : Number(value));
  model.addEventListener("change", () => drawn.show(Number(model.value)));
  beside.addEventListener("change", () => drawn.showBeside(numbered(beside)));
  mode.addEventListener("change", () => drawn.set({ mode: mode.value }));
  cut.addEventListener("change", () => drawn.set({ cut: cut.value }));
  at.addEventListener("input", () => drawn.set({ at: Number(at.value) }));
  photo.addEventListener("change", () => drawn.showPhoto(numbered(photo)));
  opacity.addEventListener("input", () => drawn.set({ opacity: Number(opacity.value) }));
  safe.addEventListener("change", () => drawn.set({ safe: safe.checked }));
  onClick("cameras", () => drawn.set({ cameras: !drawn.settings().cameras }));
  onClick("measure", () => drawn.set({ measuring: !drawn.settings().measuring }));
  onClick("reset", () => drawn.reset());
  onClick("explain", () => help.showModal());
  onClick("full", () => (document.fullscreenElement ? document.exitFullscreen() : stage.requestFullscreen()));
  document.addEventListener("fullscreenchange", () => full.setAttribute("aria-pressed", String(document.fullscreenElement === stage)));
  onClick("save-picture", () => {
    drawn.drawNow();
    composePicture(canvas, view, (picture) => saveFile(picture, "image/png", "png"));
  });
  onClick("save-model", () => {
    const bytes = Uint8Array.from(atob(files[models[drawn.settings().model].file]), (letter) => letter.charCodeAt(0));
    saveFile(bytes, "model/gltf-binary", "glb");
  });
  form.addEventListener("submit", (event) => event.preventDefault());
  addEventListener("keydown", (event) => {
    const typing = /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName ?? "");
    if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
    const number = Number.parseInt(event.key, 10) - 1;
    if (number in models) drawn.show(number);
    else if (event.key === "?" && !help.open) help.showModal();
  });
  drawn.onChange(() => {
    const settings = drawn.settings();
    model.value = settings.model;
    beside.value = settings.beside ?? NONE;
    mode.value = settings.mode;
    cut.value = settings.cut;
    photo.value = settings.photo ?? NONE;
    safe.checked = settings.safe;
    hide(![settings.model, settings.beside].some((number) => models[number]?.scale?.safe), safe);
    hide(!["x", "y", "z"].includes(settings.cut), at);
    hide(settings.photo === null, opacity);
    shown.setAttribute("aria-pressed", String(settings.cameras));
    measure.setAttribute("aria-pressed", String(settings.measuring));
    view.classList.toggle("picking", settings.measuring);
    metrics.textContent = describe(settings, models);
  });
}

function hide(isHidden, ...controls) {
  for (const control of controls) control.closest("label").hidden = isHidden;
}

function describe({ model, beside }, models) {
  const { triangles, note } = models[model];
  const text = `${COUNT.format(triangles)} triangles${note ? ` · ${note}` : ""}`;
  return beside === null || beside === model ? text : `left ${models[beside].name}, right ${models[model].name}: ${text}`;
}
