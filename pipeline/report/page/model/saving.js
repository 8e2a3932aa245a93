// Files that the reader saves: measurements, pictures and models.

/** Offer bytes for download under the title of the page. */
export function saveFile(content, type, extension) {
  const name = document.title.replace(/[^\p{L}\p{N}]+/gu, "-").replace(/^-+|-+$/g, "").slice(0, 60) || "model";
  const anchor = document.createElement("a");
  anchor.href = URL.createObjectURL(new Blob([content], { type }));
  anchor.download = `${name}.${extension}`;
  anchor.click();
  // The browser reads the address after this task.
  setTimeout(() => URL.revokeObjectURL(anchor.href), 60_000);
}

/** Copy text; without access to the clipboard, select `element` for manual copying. */
export async function copyText(text, element, button) {
  try {
    await navigator.clipboard.writeText(text);
    const usual = button.textContent;
    button.textContent = "Copied";
    setTimeout(() => (button.textContent = usual), 2000);
  } catch {
    getSelection().selectAllChildren(element);
    element.focus();
  }
}

/** Draw the view with its overlays as a PNG picture. */
export function composePicture(canvas, view, done) {
  const ratio = canvas.width / canvas.clientWidth;
  const drawing = Object.assign(document.createElement("canvas"), { width: canvas.width, height: canvas.height });
  const context = drawing.getContext("2d");
  const styles = getComputedStyle(document.documentElement);
  const [ink, panel] = ["--ink", "--paper"].map((name) => styles.getPropertyValue(name));
  context.fillStyle = panel;
  context.fillRect(0, 0, drawing.width, drawing.height);
  context.drawImage(canvas, 0, 0);
  context.scale(ratio, ratio);
  const origin = canvas.getBoundingClientRect();
  const boxOf = (element) => {
    const { left, top, width, height } = element.getBoundingClientRect();
    return [left - origin.left, top - origin.top, width, height];
  };
  context.textBaseline = "middle";
  for (const element of view.querySelectorAll("#legend, #legend .swatch, #legend .share, #legend .mark, #legend .unit, #scale, .tag")) {
    if (!element.checkVisibility()) continue;
    const [left, top, width, height] = boxOf(element);
    const { backgroundColor, color, fontSize } = getComputedStyle(element);
    context.fillStyle = backgroundColor;
    context.fillRect(left, top, width, height);
    if (element.children.length || !element.textContent) continue;
    context.fillStyle = color;
    context.font = `${fontSize} system-ui, sans-serif`;
    context.textAlign = "center";
    context.fillText(element.textContent, left + width / 2, top + height / 2);
    if (element.id !== "scale") continue;
    context.strokeStyle = ink;
    context.lineWidth = 2;
    context.strokeRect(left, top + height, width, 0);
  }
  drawing.toBlob(done, "image/png");
}
