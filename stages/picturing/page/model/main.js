// The page of one or more models in one file: a picture, a bar of controls, what is told below, and
// `window.scanloom` for scripts.
import { bar } from "./bar.js";
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
  tell(document.getElementById("told"), content);
  const drawn = picture(document.getElementById("picture"), document.getElementById("scale"), content.models);
  bar(document.getElementById("bar"), drawn, content.models);
  window.scanloom = drawn;
  await drawn.show(0);
  message.hidden = true;
}

start().catch((error) => fail(`The picture cannot be drawn here: ${error.message}`));
