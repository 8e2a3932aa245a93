// Page of a tileset: picture, controls, and `window.scanloom` for scripts.
import { bar } from "./bar.js";
import { settingsOf } from "./address.js";
import { picture } from "./picture.js";

const message = document.getElementById("message");

/** Show an error message instead of the picture. */
function fail(text) {
  message.textContent = text;
  message.hidden = false;
}

function start() {
  const drawn = picture(document.getElementById("picture"), new URL("tileset.json", location.href).href, {
    onReady: () => (message.hidden = true),
    onError: fail,
  });
  const controls = bar(document.getElementById("bar"), drawn);
  const apply = () => {
    drawn.set(settingsOf(location.hash));
    controls.show();
  };
  addEventListener("hashchange", apply);
  apply();
  // Interface for scripts and tests; see picture.js.
  window.scanloom = drawn;
}

try {
  start();
} catch (error) {
  fail(`The picture needs WebGL 2, which this browser does not give: ${error.message}`);
}
