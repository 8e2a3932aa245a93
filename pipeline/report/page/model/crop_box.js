// Crop box along the axes of the scan, with a handle on each side; `fuse.box` takes its numbers.
import { BufferGeometry, Float32BufferAttribute, LineBasicMaterial, LineSegments, Matrix4, Plane, Vector3 } from "../library.js";
import { copyText } from "./saving.js";

const AXES = ["x", "y", "z"];
const DIGITS = 4; // of the longest side: steps of at most a thousandth of it
const STEP = 0.01; // ratio of a side that an arrow key moves
const EDGES = [0, 1, 2].flatMap((axis) =>
  [0, 1].flatMap((a) =>
    [0, 1].flatMap((b) => [0, 1].map((end) => [0, 1, 2].map((one) => (one === axis ? end : (one + 3 - axis) % 3 === 1 ? a : b)))),
  ),
);

/** Return the matrix from scan coordinates to the scene, from the rotation (row-major) of the scan to z up. */
export function sceneFromScan(rotation = [1, 0, 0, 0, 1, 0, 0, 0, 1]) {
  const [x, y, z] = [0, 3, 6].map((row) => rotation.slice(row, row + 3));
  const down = y.map((value) => -value);
  return new Matrix4().set(...x, 0, ...z, 0, ...down, 0, 0, 0, 0, 1);
}

/** Create a crop box of a scene; `change` is called after every edit. */
export function createCropBox(scene, toScene, change) {
  const toScan = toScene.clone().invert();
  const axes = [0, 1, 2].map((axis) => new Vector3().setFromMatrixColumn(toScene, axis));
  const lines = new LineSegments(
    new BufferGeometry().setAttribute("position", new Float32BufferAttribute(EDGES.flat(), 3)),
    new LineBasicMaterial({ color: "#e6009e" }),
  );
  lines.matrixAutoUpdate = false;
  lines.visible = false;
  lines.frustumCulled = false;
  scene.add(lines);
  let decimals = 3;
  let limits = null; // extent of the model: lowest three, then highest three coordinates
  let sides = null;

  /** Set the limits to the extent of a model. */
  function fit(model) {
    const [low, high] = [new Vector3(Infinity, Infinity, Infinity), new Vector3(-Infinity, -Infinity, -Infinity)];
    model.updateMatrixWorld(true);
    model.traverse((one) => {
      if (!one.isMesh) return;
      const matrix = toScan.clone().multiply(one.matrixWorld);
      const { position } = one.geometry.attributes;
      const point = new Vector3();
      for (let index = 0; index < position.count; index++) {
        point.fromBufferAttribute(position, index).applyMatrix4(matrix);
        low.min(point);
        high.max(point);
      }
    });
    const longest = Math.max(...high.clone().sub(low).toArray(), 1e-9);
    decimals = Math.min(Math.max(DIGITS - 1 - Math.floor(Math.log10(longest)), 0), 9);
    const grid = 10 ** decimals;
    const lowest = low.toArray().map((value) => Math.floor(grid * value));
    // A flat model gets a box of one step.
    const highest = high.toArray().map((value, axis) => Math.max(Math.ceil(grid * value), lowest[axis] + 1));
    limits = [...lowest, ...highest].map((value) => value / grid);
  }

  function place() {
    const size = AXES.map((_, axis) => sides[3 + axis] - sides[axis]);
    const local = new Matrix4().makeTranslation(sides[0], sides[1], sides[2]).scale(new Vector3(...size));
    lines.matrix.multiplyMatrices(toScene, local);
    lines.matrixWorldNeedsUpdate = true;
  }

  return {
    axes,
    sides: () => sides && [...sides],
    step: () => 10 ** -decimals,
    toScan: (point) => point.clone().applyMatrix4(toScan).toArray(),
    /** Format the box as the option of the command line. */
    option: () => `--box ${sides.map((value) => value.toFixed(decimals)).join(" ")}`,
    /** Show or hide the box; at first it encloses `model`. */
    show(isShown, model) {
      lines.visible = isShown;
      if (!isShown || sides) return;
      fit(model);
      sides = [...limits];
      place();
    },
    reset() {
      sides = [...limits];
      place();
      change();
    },
    /** Move a side, 0 to 5, in scan coordinates; the box keeps a positive size. */
    move(side, value) {
      if (!Number.isFinite(value)) return;
      const grid = 10 ** decimals;
      const end = Math.round(grid * sides[(side + 3) % 6]);
      const wanted = Math.round(grid * value);
      sides[side] = (side < 3 ? Math.min(wanted, end - 1) : Math.max(wanted, end + 1)) / grid;
      place();
      change();
    },
    /** Return the planes that keep the inside, in the scene. */
    planes: () => sides.map((value, side) => (side < 3 ? new Plane(axes[side].clone(), -value) : new Plane(axes[side - 3].clone().negate(), value))),
    /** Return the middle of a side, in the scene. */
    middle(side) {
      const point = AXES.map((_, axis) => (sides[axis] + sides[3 + axis]) / 2);
      point[side % 3] = sides[side];
      return new Vector3(...point).applyMatrix4(toScene);
    },
  };
}

const nameOf = (side) => `${side < 3 ? "Lowest" : "Highest"} ${AXES[side % 3]}`;

/** Create the handles of the box over the picture; `along` returns the coordinate under the pointer on an axis. */
export function createHandles(overlay, box, along) {
  const handles = [0, 1, 2, 3, 4, 5].map((side) => {
    const handle = document.createElement("button");
    handle.type = "button";
    handle.className = `handle axis-${AXES[side % 3]}`;
    handle.setAttribute("aria-label", `${nameOf(side)} of the crop box; arrow keys move it`);
    handle.addEventListener("pointerdown", (event) => handle.setPointerCapture(event.pointerId));
    handle.addEventListener("pointermove", (event) => {
      if (handle.hasPointerCapture(event.pointerId)) box.move(side, along(event, box.middle(side), side % 3));
    });
    handle.addEventListener("keydown", (event) => {
      const direction = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
      if (!direction) return;
      event.preventDefault();
      const sides = box.sides();
      const size = sides[3 + (side % 3)] - sides[side % 3];
      box.move(side, sides[side] + direction * Math.max(STEP * size, box.step()));
    });
    overlay.append(handle);
    return handle;
  });
  return (isShown, project) => {
    for (const [side, handle] of handles.entries()) {
      const at = isShown && project(box.middle(side));
      handle.hidden = !at;
      if (at) [handle.style.left, handle.style.top] = at.map((value) => `${value}px`);
    }
  };
}

/** Connect the panel of the box: coordinates, and the option to copy. */
export function connectBoxPanel(panel, drawn, box) {
  const [numbers, option, copy, reset] = ["#numbers", "#option", "#copy-box", "#reset-box"].map((id) => panel.querySelector(id));
  option.tabIndex = 0;
  option.setAttribute("aria-label", "Option of scanloom fuse");
  const inputs = [];
  AXES.forEach((name, axis) => {
    const row = Object.assign(document.createElement("span"), { textContent: name, className: `name axis-${name}` });
    numbers.append(row);
    for (const side of [axis, axis + 3]) {
      const input = Object.assign(document.createElement("input"), { type: "number" });
      input.setAttribute("aria-label", nameOf(side));
      input.addEventListener("change", () => box.move(side, input.valueAsNumber));
      inputs[side] = input;
      numbers.append(input);
    }
  });
  copy.addEventListener("click", () => copyText(box.option(), option, copy));
  reset.addEventListener("click", () => box.reset());
  drawn.onChange(() => {
    panel.hidden = drawn.settings().cut !== "box";
    if (panel.hidden) return;
    option.textContent = box.option();
    const sides = box.sides();
    for (const [side, input] of inputs.entries()) {
      input.step = box.step();
      input.value = sides[side];
    }
  });
}
