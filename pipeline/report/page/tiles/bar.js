// Controls below the picture, and statistics of the drawn tiles.

const WHOLE = new Intl.NumberFormat("en");

/** Connect the controls of a form to the picture; `show` updates them from its settings. */
export function bar(form, picture) {
  const { target, mode, wireframe, all } = form.elements;
  const pixels = form.querySelector("#target-px");
  const metrics = form.querySelector("#metrics");

  function show() {
    const settings = picture.settings();
    target.value = Math.log2(settings.error);
    pixels.textContent = `${settings.error < 10 ? +settings.error.toPrecision(2) : Math.round(settings.error)} px`;
    mode.value = settings.mode;
    wireframe.checked = settings.wireframe;
  }

  target.addEventListener("input", () => {
    picture.set({ error: 2 ** target.valueAsNumber });
    show();
  });
  mode.addEventListener("change", () => picture.set({ mode: mode.value }));
  wireframe.addEventListener("change", () => picture.set({ wireframe: wireframe.checked }));
  all.addEventListener("click", () => picture.showAll());
  form.addEventListener("submit", (event) => event.preventDefault());
  picture.onChange(() => (metrics.textContent = sentence(picture.metrics())));
  show();
  return { show };
}

function sentence({ triangles, tilesDrawn, tilesLoaded, errorM }) {
  const proven = errorM === null ? "" : ` · error at most ${length(errorM)}`;
  return `${WHOLE.format(triangles)} triangles · ${tilesDrawn} of ${tilesLoaded} loaded tiles drawn${proven}`;
}

/** Format a length with three digits, rounded up because it is a bound. */
function length(metres) {
  const [value, unit] = metres < 1e-3 ? [metres * 1e6, "µm"] : metres < 1 ? [metres * 1e3, "mm"] : [metres, "m"];
  if (!(value > 0)) return `0 ${unit}`;
  const step = 10 ** (Math.floor(Math.log10(value)) - 2);
  return `${+(Math.ceil(value / step - 1e-9) * step).toPrecision(3)} ${unit}`;
}
