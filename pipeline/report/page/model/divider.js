// Divider between two models, moved by pointer or keys.
const STEP = 0.02; // ratio of the width per key press

/** Make an element a divider; `moved` is called with its position as a ratio of the width. */
export function divider(element, moved) {
  let share = 0.5;

  function set(value) {
    share = Math.min(Math.max(value, 0), 1);
    element.style.left = `${100 * share}%`;
    element.setAttribute("aria-valuenow", Math.round(100 * share));
    moved(share);
  }

  element.addEventListener("pointerdown", (event) => element.setPointerCapture(event.pointerId));
  element.addEventListener("pointermove", (event) => {
    if (!element.hasPointerCapture(event.pointerId)) return;
    const { left, width } = element.parentElement.getBoundingClientRect();
    set((event.clientX - left) / width);
  });
  element.addEventListener("keydown", ({ key }) => {
    const step = { ArrowLeft: -STEP, ArrowRight: STEP }[key];
    if (step) set(share + step);
  });
  return { set, share: () => share };
}
