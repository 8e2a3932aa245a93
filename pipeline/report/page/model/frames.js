// Row of photos with the status of their frames; a click moves the view to the photo's camera.

/** Create a list of photo buttons; `chosen` is called with the camera index. */
export function frames(cameras, chosen) {
  const list = made("ul", "frames");
  list.tabIndex = 0;
  list.setAttribute("aria-label", "Photos of frames");
  cameras.forEach(({ frame, photo, mark, size }, number) => {
    if (!photo) return;
    const button = made("button", mark ? "frame marked" : "frame");
    button.type = "button";
    const image = made("img");
    image.src = photo;
    image.alt = "";
    image.decoding = "async";
    [image.width, image.height] = [120, Math.round((120 * size[1]) / size[0])];
    button.append(image, made("span", "name", frame));
    if (mark) button.append(made("span", "mark", mark));
    button.setAttribute("aria-label", `Look from frame ${frame}${mark ? `, ${mark}` : ""}`);
    button.addEventListener("click", () => chosen(number));
    const entry = made("li");
    entry.append(button);
    list.append(entry);
  });
  return list;
}

function made(kind, name = "", text = "") {
  const element = document.createElement(kind);
  if (name) element.className = name;
  if (text) element.textContent = text;
  return element;
}
