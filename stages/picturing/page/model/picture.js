// The picture of one of several models, which share a camera; drawn again when something has changed, and only then.
import {
  Box3,
  BufferGeometry,
  DirectionalLight,
  DoubleSide,
  Float32BufferAttribute,
  GLTFLoader,
  Group,
  HemisphereLight,
  LineBasicMaterial,
  LineSegments,
  MeshBasicMaterial,
  MeshLambertMaterial,
  MeshoptDecoder,
  Points,
  PointsMaterial,
  Raycaster,
  Scene,
  Vector2,
  Vector3,
  WebGLRenderer,
} from "../library.js";
import { orbitingCamera } from "../tiles/camera.js";

const MOST_PIXELS = 2; // of the screen to one of the page: more are not seen
const STILL = 5; // pixels that a click may move
const BAR = 0.22; // of the picture's width, the longest scale bar
const MARK = "#e6009e";

const clay = new MeshLambertMaterial({ color: "#cfccc6", side: DoubleSide, flatShading: true });
const lines = new MeshBasicMaterial({ color: "#3a4657", wireframe: true });

export function picture(canvas, scale, models) {
  const renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true, preserveDrawingBuffer: false });
  renderer.setPixelRatio(Math.min(devicePixelRatio, MOST_PIXELS));
  const scene = new Scene();
  const sun = new DirectionalLight("#ffffff", 1.6);
  scene.add(new HemisphereLight("#ffffff", "#8a8f98", 1.8), sun);
  const marks = new Group();
  scene.add(marks);
  const heard = [];
  const loaded = new Map();
  const view = orbitingCamera(canvas, change);
  const loader = new GLTFLoader().setMeshoptDecoder(MeshoptDecoder);
  const state = { model: 0, mode: "colors", measuring: false };
  let shown = null;
  let points = [];
  let waiting = false;

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
    renderer.render(scene, view.camera);
    drawScale(width, height);
  }

  /** A bar of a round length where the camera looks at. */
  function drawScale(width, height) {
    const { eye, target, fov } = view.view();
    const away = Math.hypot(...eye.map((value, axis) => value - target[axis]));
    const metres = (2 * away * Math.tan((fov * Math.PI) / 360)) / height;
    const longest = BAR * width * metres;
    if (!(longest > 0)) return;
    const power = 10 ** Math.floor(Math.log10(longest));
    const length = power * [5, 2, 1].find((digit) => digit * power <= longest);
    scale.style.width = `${length / metres}px`;
    scale.textContent = length < 0.01 ? `${+(1000 * length).toPrecision(1)} mm` : length < 1 ? `${+(100 * length).toPrecision(1)} cm` : `${length} m`;
    scale.hidden = false;
  }

  async function load(number) {
    if (!loaded.has(number)) {
      const bytes = Uint8Array.from(atob(models[number].glb), (letter) => letter.charCodeAt(0));
      const { scene: found } = await loader.parseAsync(bytes.buffer, "");
      found.traverse((one) => {
        if (one.isMesh) {
          one.userData.own = one.material;
          one.material.side = DoubleSide;
        }
      });
      loaded.set(number, found);
    }
    return loaded.get(number);
  }

  function dress() {
    shown?.traverse((one) => {
      if (!one.isMesh) return;
      one.material = state.mode === "clay" ? clay : state.mode === "triangles" ? lines : one.userData.own;
    });
  }

  function changed() {
    dress();
    marks.clear();
    if (points.length) {
      const places = new Float32BufferAttribute(points.flatMap((point) => point.toArray()), 3);
      const geometry = new BufferGeometry().setAttribute("position", places);
      const dots = new PointsMaterial({ color: MARK, size: 9, sizeAttenuation: false, depthTest: false });
      const line = new LineBasicMaterial({ color: MARK, depthTest: false });
      marks.add(new Points(geometry, dots), new LineSegments(geometry, line));
    }
    heard.forEach((hear) => hear());
    change();
  }

  /** Take the point of the surface at a place of the canvas, in pixels of the page; whether there is one. */
  function pick(x, y) {
    const { clientWidth: width, clientHeight: height } = canvas;
    const caster = new Raycaster();
    caster.setFromCamera(new Vector2((2 * x) / width - 1, 1 - (2 * y) / height), view.camera);
    const [hit] = shown ? caster.intersectObject(shown, true) : [];
    if (!hit) return false;
    points = points.length < 2 ? [...points, hit.point.clone()] : [hit.point.clone()];
    changed();
    return true;
  }

  let pressed = null;
  canvas.addEventListener("pointerdown", ({ offsetX, offsetY }) => (pressed = [offsetX, offsetY]));
  canvas.addEventListener("pointerup", ({ offsetX, offsetY }) => {
    if (!state.measuring || !pressed) return;
    if (Math.hypot(offsetX - pressed[0], offsetY - pressed[1]) <= STILL) pick(offsetX, offsetY);
  });
  addEventListener("keydown", ({ key }) => key === "Escape" && set({ measuring: false }));
  new ResizeObserver(change).observe(canvas);

  function set(settings) {
    Object.assign(state, settings);
    if (!state.measuring) points = [];
    changed();
  }

  return {
    settings: () => ({ ...state }),
    set,
    pick,
    points: () => points.map((point) => point.toArray()),
    distance: () => (points.length === 2 ? points[0].distanceTo(points[1]) : null),
    onChange: (hear) => heard.push(hear),
    showAll: () => view.showAll(),
    look: (settings) => view.set(settings),
    view: () => view.view(),
    /** Draw at once, and return after it is on the screen. */
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
        view.setModel(new Box3().setFromObject(found), models[number].facing);
        view.showAll();
      }
      state.model = number;
      changed();
    },
    /** Fly to a place of the scan, given in the model's upright frame, metres, z up. */
    flyTo(target, away) {
      const { eye, target: before } = view.view();
      const from = new Vector3(...eye).sub(new Vector3(...before)).setLength(away);
      view.set({ eye: new Vector3(...target).add(from).toArray(), target });
    },
  };
}
