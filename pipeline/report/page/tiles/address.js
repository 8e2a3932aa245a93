// Settings in the URL fragment, so that a view can be saved as a link:
// #eye=1,2,3&target=0,0,0&fov=50&error=4&mode=levels&wireframe=1

/** Parse the settings of a URL fragment, ignoring invalid ones. */
export function settingsOf(hash) {
  const words = new URLSearchParams(hash.replace(/^#/, ""));
  const settings = {};
  for (const name of ["eye", "target"]) {
    const numbers = (words.get(name) ?? "").split(",").map(Number.parseFloat);
    if (numbers.length === 3 && numbers.every(Number.isFinite)) settings[name] = numbers;
  }
  for (const name of ["fov", "error"]) {
    const number = Number.parseFloat(words.get(name));
    if (number > 0 && Number.isFinite(number)) settings[name] = number;
  }
  if (["colors", "levels"].includes(words.get("mode"))) settings.mode = words.get("mode");
  if (words.has("wireframe")) settings.wireframe = words.get("wireframe") !== "0";
  return settings;
}
