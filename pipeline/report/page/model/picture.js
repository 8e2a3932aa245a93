// Picture of one or two models with a shared camera, redrawn only after changes.
import {
  Box3,
  DirectionalLight,
  DoubleSide,
  GLTFLoader,
  HemisphereLight,
  MeshBasicMaterial,
  MeshLambertMaterial,
  MeshoptDecoder,
  Plane,
  Raycaster,
  Scene,
  Vector2,
  Vector3,
  WebGLRenderer,
} from "../library.js";
import { orbitingCamera, outOfScene } from "../tiles/camera.js";
import { camerasOf } from "./cameras.js";
import { createCropBox, createHandles, sceneFromScan } from "./crop_box.js";
import { inLook, recolor } from "./looks.js";
import { createMeasurements } from "./measurements.js";

const MOST_PIXELS = 2; // maximum device pixels per CSS pixel: more make no visible difference
const STILL = 5; // maximum pointer movement of a click, pixels
const BAR = 0.22; // maximum length of the scale bar, as a ratio of the width
const SHORTEST = 130; // maximum length on narrow screens, pixels: the text must fit
const ENOUGH = 5000; // maximum points sampled of a mesh to frame it
const MOST_COSINE = 0.998; // between a ray and an axis along which the pointer moves a side
const FRAMED = 1.08; // size of the view from a photo's camera, relative to the photo
// Normals of the cutting planes in the scene; the side they point to is kept.
const CUTS = { x: [-1, 0, 0], y: [0, 0, 1], z: [0, -1, 0] };

const clay = new MeshLambertMaterial({ color: "#cfccc6", side: DoubleSide, flatShading: true });
const lines = new MeshBasicMaterial({ color: "#3a4657", wireframe: true });

/** Draw models on a canvas; elements at 3-D positions are added to `overlay`. */
export function picture(canvas, overlay, scale, { files, models, cameras = [], unit = "m", rotation }) {
  const renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true, preserveDrawingBuffer: false });
  renderer.setPixelRatio(Math.min(devicePixelRatio, MOST_PIXELS));
  const scene = new Scene();
  const sun = new DirectionalLight("#ffffff", 1.6);
  scene.add(new HemisphereLight("#ffffff", "#8a8f98", 1.8), sun);
  const heard = [];
  const loaded = new Map();
  renderer.localClippingEnabled = true;
  const view = orbitingCamera(canvas, change);
  const measurements = createMeasurements(scene, unit, changed);
  const cropBox = createCropBox(scene, sceneFromScan(rotation), changed);
  const placeHandles = createHandles(overlay, cropBox, coordinateAlong);
  const tags = new Map(); // labels of measurements
  const loader = new GLTFLoader().setMeshoptDecoder(MeshoptDecoder);
  // `beside`: model shown left of `split`, a ratio of the width; `cut`: axis of the cutting plane, `at` a ratio of the box.
  const state = { model: 0, mode: "colors", measuring: false, beside: null, split: 0.5, cut: "none", at: 0.5, cameras: false, photo: null, opacity: 0.6, safe: false };
  const box = new Box3();
  const frustums = camerasOf(cameras, scene, change);
  let shown = null;
  let planes = []; // clipping planes of the models
  let waiting = false;
  let usual; // field of view before a photo was shown

  function change() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      draw();
    });
  }

  function draw() {
    const { clientWidth: width, clientHeight: height } = canvas;
    const size = renderer.getSize(new Vector2());
    if (size.x !== width || size.y !== height) {
      renderer.setSize(width, height, false);
      view.resize(width, height);
    }
    view.fitDepth();
    sun.position.copy(view.camera.position);
    const other = otherModel();
    if (other) {
      const edge = Math.round(width * state.split);
      renderer.setScissorTest(true);
      for (const [model, left, wide] of [[other, 0, edge], [shown, edge, width - edge]]) {
        if (wide <= 0) continue;
        other.visible = model === other;
        shown.visible = model === shown;
        renderer.setScissor(left, 0, wide, height);
        renderer.render(scene, view.camera);
      }
      renderer.setScissorTest(false);
      shown.visible = other.visible = true;
    } else renderer.render(scene, view.camera);
    drawScale(width, height);
    drawOverlay();
  }

  /** Return the canvas position of a point in CSS pixels; null if it is behind the camera. */
  function project(point) {
    const at = point.clone().project(view.camera);
    return at.z < -1 || at.z > 1 ? null : [((at.x + 1) / 2) * canvas.clientWidth, ((1 - at.y) / 2) * canvas.clientHeight];
  }

  /** Move the labels of measurements and the handles of the crop box to their points. */
  function drawOverlay() {
    for (const [entry, tag] of tags) {
      const text = [measurements.format(entry), entry.text].filter(Boolean).join(" · ");
      const at = text && project(measurements.middleOf(entry));
      tag.hidden = !at;
      if (!at) continue;
      tag.textContent = text;
      [tag.style.left, tag.style.top] = at.map((value) => `${value}px`);
    }
    placeHandles(state.cut === "box", project);
  }

  function updateTags() {
    for (const [entry, tag] of tags) {
      if (measurements.entries.includes(entry)) continue;
      tag.remove();
      tags.delete(entry);
    }
    for (const entry of measurements.entries) {
      if (tags.has(entry)) continue;
      tags.set(entry, Object.assign(document.createElement("span"), { className: "tag" }));
      overlay.append(tags.get(entry));
    }
  }

  function rayAt(x, y) {
    const caster = new Raycaster();
    caster.setFromCamera(new Vector2((2 * x) / canvas.clientWidth - 1, 1 - (2 * y) / canvas.clientHeight), view.camera);
    return caster;
  }

  /** Return the scan coordinate on an axis through `point` that is nearest to the ray of a pointer. */
  function coordinateAlong({ clientX, clientY }, point, axis) {
    const { left, top } = canvas.getBoundingClientRect();
    const { origin, direction } = rayAt(clientX - left, clientY - top).ray;
    const line = cropBox.axes[axis];
    const cosine = line.dot(direction);
    const offset = point.clone().sub(origin);
    const along = (cosine * offset.dot(direction) - offset.dot(line)) / (1 - cosine * cosine);
    // An axis that points at the camera has no position under the pointer.
    return cropBox.toScan(point)[axis] + (Math.abs(cosine) < MOST_COSINE ? along : 0);
  }

  /** Draw a scale bar of a round length, measured at the camera target. */
  function drawScale(width, height) {
    const { eye, target, fov } = view.view();
    const away = Math.hypot(...eye.map((value, axis) => value - target[axis]));
    const metres = (2 * away * Math.tan((fov * Math.PI) / 360)) / height;
    const longest = Math.max(BAR * width, SHORTEST) * metres;
    if (!(longest > 0)) return;
    const power = 10 ** Math.floor(Math.log10(longest));
    const length = power * [5, 2, 1].find((digit) => digit * power <= longest);
    scale.style.width = `${length / metres}px`;
    scale.textContent = inWords(length);
    scale.hidden = false;
  }

  function inWords(length) {
    if (unit !== "m" || length >= 1) return `${+length.toPrecision(1)} ${unit}`;
    return length < 0.01 ? `${+(1000 * length).toPrecision(1)} mm` : `${+(100 * length).toPrecision(1)} cm`;
  }

  const read = new Map();

  /** Load a file once for all its colourings. */
  function readFile(number) {
    if (!read.has(number)) {
      const bytes = Uint8Array.from(atob(files[number]), (letter) => letter.charCodeAt(0));
      read.set(number, loader.parseAsync(bytes.buffer, "").then(({ scene: found }) => found));
    }
    return read.get(number);
  }

  async function load(number) {
    if (!loaded.has(number)) {
      const { file, look, scale: colors } = models[number];
      const model = await readFile(file);
      const found = look === "own" ? model : inLook(model, look, colors);
      found.traverse((one) => {
        if (one.isMesh) {
          one.userData.own = one.material;
          one.material.side = DoubleSide;
        }
      });
      if (!loaded.has(number)) loaded.set(number, found);
    }
    return loaded.get(number);
  }

  /** Sample points of a model, in scene coordinates. */
  function pointsOf(found) {
    const points = [];
    found.traverse((one) => {
      if (!one.isMesh) return;
      const places = one.geometry.attributes.position;
      const step = Math.ceil(places.count / ENOUGH);
      for (let k = 0; k < places.count; k += step) points.push(new Vector3().fromBufferAttribute(places, k).applyMatrix4(one.matrixWorld));
    });
    return points;
  }

  /** Sample the area vectors of a model's triangles, in the scene. */
  function sampleAreas(found) {
    const areas = [];
    found.traverse((one) => {
      if (!one.isMesh) return;
      const { index, attributes } = one.geometry;
      const count = (index ?? attributes.position).count / 3;
      const step = Math.ceil(count / ENOUGH);
      for (let triangle = 0; triangle < count; triangle += step) {
        const [a, b, c] = [0, 1, 2].map((corner) => {
          const at = 3 * triangle + corner;
          return new Vector3().fromBufferAttribute(attributes.position, index ? index.getX(at) : at).applyMatrix4(one.matrixWorld);
        });
        areas.push(b.sub(a).cross(c.sub(a)));
      }
    });
    return areas;
  }

  /** Return the model left of the divider; null if only one model is shown. */
  function otherModel() {
    const other = state.beside === null || state.beside === state.model ? null : loaded.get(state.beside);
    return shown && other ? other : null;
  }

  function choosePlanes() {
    if (state.cut === "box") return cropBox.planes();
    const normal = CUTS[state.cut];
    if (!normal) return [];
    const along = new Vector3(...normal);
    // 0 removes everything, 1 keeps everything.
    const ends = [box.min, box.max].map((corner) => -along.dot(corner)).sort((a, b) => a - b);
    return [new Plane(along, ends[0] + (ends[1] - ends[0]) * state.at)];
  }

  function dress() {
    cropBox.show(state.cut === "box", shown);
    planes = choosePlanes();
    for (const [number, model] of loaded) {
      const colors = models[number].scale;
      if (colors?.safe) recolor(model, state.safe ? colors.safe : colors.colors);
      model.traverse((one) => {
        if (!one.isMesh) return;
        one.material = state.mode === "clay" ? clay : state.mode === "triangles" ? lines : one.userData.own;
        one.material.clippingPlanes = planes;
      });
      if (model.parent && model !== shown && model !== otherModel()) scene.remove(model);
    }
    if (otherModel()) scene.add(otherModel());
    frustums.visible = state.cameras && state.photo === null;
    frustums.opacity = state.opacity;
  }

  function changed() {
    dress();
    updateTags();
    heard.forEach((hear) => hear());
    change();
  }

  function hitOf(caster, model) {
    const hits = model ? caster.intersectObject(model, true) : [];
    return hits.find(({ point }) => planes.every((plane) => plane.distanceToPoint(point) >= 0));
  }

  /** View the model from the camera of a photo, with the photo as overlay; null removes it. */
  async function showPhoto(number) {
    if (state.photo === null) usual = view.view().fov;
    state.photo = number;
    if (number === null) {
      view.set({ fov: usual });
      await frustums.show(null);
      return changed();
    }
    const { eye, ahead, corners } = frustums.all[number];
    const forward = ahead.clone().sub(eye);
    const caster = new Raycaster(eye, forward);
    const depth = (hitOf(caster, shown) ?? { distance: 0.5 * box.getSize(new Vector3()).length() }).distance;
    // Keep the view upright, and wide enough for the whole photo.
    const right = forward.clone().cross(new Vector3(0, 1, 0)).normalize();
    const up = right.clone().cross(forward).normalize();
    const most = (axis) => Math.max(...corners.map((corner) => Math.abs(corner.clone().sub(eye).dot(axis))));
    const tall = FRAMED * Math.max(most(up), most(right) / view.camera.aspect);
    view.set({ eye: outOfScene(eye), target: outOfScene(eye.clone().addScaledVector(forward, depth)), fov: (2 * Math.atan(tall) * 180) / Math.PI });
    changed();
    await frustums.show(number, depth);
    changed();
  }

  function pickCamera(x, y) {
    const found = frustums.under(rayAt(x, y).ray);
    if (found !== null) showPhoto(found);
    return found;
  }

  /** Return the surface point at a canvas position in CSS pixels; null if there is none. */
  function findPoint(x, y) {
    const model = otherModel() && x < canvas.clientWidth * state.split ? otherModel() : shown;
    return hitOf(rayAt(x, y), model)?.point ?? null;
  }

  /** Add the surface point at a canvas position to the measurement; return false if there is none. */
  function pick(x, y) {
    const point = findPoint(x, y);
    if (point) measurements.addPoint(point);
    return point !== null;
  }

  /** Rotate and zoom around a point of the scene from now on. */
  function center(point) {
    view.set({ target: outOfScene(point) });
  }

  let pressed = null;
  let held = null; // view at the start of a touch
  canvas.addEventListener("pointerdown", ({ offsetX, offsetY, isPrimary }) => {
    if (!isPrimary) return;
    pressed = [offsetX, offsetY];
    held = view.view();
  });
  // The browser scrolls the page from here on: undo the rotation by the first pixels.
  canvas.addEventListener("pointercancel", () => view.set(held));
  canvas.addEventListener("click", ({ offsetX, offsetY, detail }) => {
    if (detail > 1 || !pressed || Math.hypot(offsetX - pressed[0], offsetY - pressed[1]) > STILL) return;
    if (state.measuring) pick(offsetX, offsetY);
    else if (state.cameras) pickCamera(offsetX, offsetY);
  });
  canvas.addEventListener("dblclick", ({ offsetX, offsetY }) => {
    const point = state.measuring ? null : findPoint(offsetX, offsetY);
    if (point) center(point);
  });
  // One finger scrolls the page vertically, and rotates horizontally.
  canvas.style.touchAction = "pan-y";
  // Browsers may scroll with two fingers too, which would end panning and zooming.
  for (const kind of ["touchstart", "touchmove"]) {
    canvas.addEventListener(kind, (event) => event.touches.length > 1 && event.cancelable && event.preventDefault(), { passive: false });
  }
  document.addEventListener("fullscreenchange", () => (canvas.style.touchAction = document.fullscreenElement ? "none" : "pan-y"));
  addEventListener("keydown", ({ key, target }) => {
    if (key !== "Escape" || target.closest?.("dialog")) return;
    if (state.photo !== null) showPhoto(null);
    set({ measuring: false });
  });
  new ResizeObserver(change).observe(canvas);

  function set(settings) {
    const hadCameras = state.cameras;
    Object.assign(state, settings);
    if (!state.measuring) measurements.cancel();
    changed();
    if (state.cameras !== hadCameras) includeCameras();
  }

  /** Include the cameras in the overview while they are shown, and move back if some are outside the picture. */
  function includeCameras() {
    const eyes = state.cameras ? frustums.all.map(({ eye }) => eye) : [];
    view.include(eyes);
    const isOutside = (eye) => {
      const { x, y, z } = eye.clone().project(view.camera);
      return Math.max(Math.abs(x), Math.abs(y), Math.abs(z)) > 1;
    };
    if (eyes.some(isOutside)) view.showAll();
    change();
  }

  /** Show the whole model from the initial side. */
  async function reset() {
    if (state.photo !== null) await showPhoto(null);
    view.showAll();
  }

  /** Show a second model left of the divider; null shows one model only. */
  async function showBeside(number) {
    if (number !== null) await load(number);
    set({ beside: number });
  }

  return {
    settings: () => ({ ...state }),
    set,
    pick,
    pickCamera,
    showBeside,
    showPhoto,
    center,
    measurements,
    cropBox,
    /** Return the measurements and notes, with points in scan coordinates. */
    annotations: () => ({ unit, annotations: measurements.list(cropBox.toScan) }),
    onChange: (hear) => heard.push(hear),
    reset,
    look: (settings) => view.set(settings),
    view: () => view.view(),
    /** Draw now, and resolve after the frame is on the screen. */
    drawNow: draw,
    drawn: () => new Promise((done) => requestAnimationFrame(() => (draw(), requestAnimationFrame(done)))),
    async show(number) {
      const found = await load(number);
      const first = shown === null;
      if (shown) scene.remove(shown);
      shown = found;
      scene.add(found);
      found.updateMatrixWorld(true);
      if (first) {
        const { clientWidth: width, clientHeight: height } = canvas;
        renderer.setSize(width, height, false);
        view.resize(width, height);
        box.setFromObject(found);
        view.setModel(box, models[number].facing, pointsOf(found), sampleAreas(found));
        frustums.build(box.getSize(new Vector3()).length());
        view.showAll();
      }
      state.model = number;
      changed();
    },
    /** Move the view to a location in the upright frame (metres, z up), at a distance `away`. */
    flyTo(target, away) {
      const { eye, target: before } = view.view();
      const from = new Vector3(...eye).sub(new Vector3(...before)).setLength(away);
      view.set({ eye: new Vector3(...target).add(from).toArray(), target });
    },
  };
}
