// Single-file page of models: header, picture, controls, report below, and `window.scanloom` for scripts.
import { connectBoxPanel } from "./crop_box.js";
import { divider } from "./divider.js";
import { fillHeader } from "./header.js";
import { legend } from "./legend.js";
import { connectPanel } from "./measurement_panel.js";
import { picture } from "./picture.js";
import { fillReport } from "./report.js";
import { connectToolbar } from "./toolbar.js";

const message = document.getElementById("message");
const content = JSON.parse(document.getElementById("content").textContent);

function fail(text) {
  message.textContent = text;
  message.hidden = false;
}

async function start() {
  fillHeader(content);
  fillReport(document.getElementById("report"), content);
  const { models, title } = content;
  const [canvas, overlay, scaleBar, line, colors, measurementPanel, boxPanel] = ["picture", "overlay", "scale", "divider", "legend", "measurements", "box"].map((id) =>
    document.getElementById(id),
  );
  const drawn = picture(canvas, overlay, scaleBar, content);
  const moved = divider(line, (split) => drawn.set({ split }));
  connectToolbar(drawn, content);
  connectPanel(measurementPanel, drawn, drawn.measurements, title);
  connectBoxPanel(boxPanel, drawn, drawn.cropBox);
  let explained = null;
  drawn.onChange(() => {
    const { model, beside, safe } = drawn.settings();
    line.hidden = beside === null || beside === model;
    const { scale, name } = models[model].scale ? models[model] : (models[beside] ?? {});
    const wanted = scale && `${model} ${beside} ${safe}`;
    if (wanted !== explained) legend(colors, scale, name, safe);
    explained = wanted;
  });
  window.scanloom = { ...drawn, divide: moved.set };
  await drawn.show(0);
  message.hidden = true;
}

start().catch((error) => fail(`The picture cannot be drawn here: ${error.message}`));
