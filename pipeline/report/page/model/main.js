// Single-file page of models: picture, controls, report data below, and `window.scanloom` for scripts.
import { bar } from "./bar.js";
import { divider } from "./divider.js";
import { legend } from "./legend.js";
import { picture } from "./picture.js";
import { tell } from "./told.js";

const message = document.getElementById("message");
const content = JSON.parse(document.getElementById("content").textContent);

function fail(text) {
  message.textContent = text;
  message.hidden = false;
}

async function start() {
  document.title = content.title;
  document.getElementById("title").textContent = content.title;
  const { files, models, cameras = [], unit = "m" } = content;
  const drawn = picture(document.getElementById("picture"), document.getElementById("scale"), files, models, cameras, unit);
  const line = document.getElementById("divider");
  const moved = divider(line, (split) => drawn.set({ split }));
  bar(document.getElementById("bar"), drawn, models, cameras, unit);
  let explained = null;
  drawn.onChange(() => {
    const { model, beside, safe } = drawn.settings();
    line.hidden = beside === null || beside === model;
    const scale = models[model].scale ?? models[beside]?.scale;
    const wanted = scale && `${model} ${beside} ${safe}`;
    if (wanted !== explained) legend(document.getElementById("legend"), scale, safe);
    explained = wanted;
  });
  window.scanloom = { ...drawn, divide: moved.set };
  tell(document.getElementById("told"), content);
  await drawn.show(0);
  message.hidden = true;
}

start().catch((error) => fail(`The picture cannot be drawn here: ${error.message}`));
