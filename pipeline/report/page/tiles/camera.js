// Orbit camera. Positions outside this file are in the frame of the tileset or model (metres, z up);
// three.js uses y up.
import { OrbitControls, PerspectiveCamera, Sphere, Spherical, Vector3 } from "../library.js";

const FIELD_OF_VIEW = 50; // vertical, degrees
// Initial direction from model to camera: from the front and slightly above, y up.
const FIRST_LOOK = new Vector3(0.45, 0.4, 1).normalize();
const LEVEL = 0.2; // minimum horizontal component of the mean normal to choose a front side
const ROOM = 1.15; // margin around the model in the overview
const TURN = Math.PI / 36; // rotation per arrow key
const STEP = 0.85; // factor on the distance per + or - key
// Minimum near plane as a ratio of the model radius: a smaller one would waste depth buffer precision.
const NEAREST = 1e-3;
// The initial direction is kept if it shows at least this ratio of the surface that the best direction shows.
const SHOWN = 0.6;
// Candidates for the best direction: steps around the up axis, and elevations in radians.
const TURNS = 24;
const ELEVATIONS = [0.4, 0.9];

const intoScene = ([x, y, z]) => new Vector3(x, z, -y);
export const outOfScene = ({ x, y, z }) => [x, -z, y];
const cornersOf = ({ min, max }) =>
  [min.x, max.x].flatMap((x) => [min.y, max.y].flatMap((y) => [min.z, max.z].map((z) => new Vector3(x, y, z))));

/** Return the projected area of the surface that faces a direction, from sampled area vectors. */
const shownArea = (direction, areas) => areas.reduce((sum, area) => sum + Math.max(area.dot(direction), 0), 0);

/** Return a direction that shows the surface: `usual`, unless the surface is edge-on or faces away there. */
function chooseDirection(usual, areas) {
  let [best, most] = [usual, shownArea(usual, areas) / SHOWN];
  for (const elevation of ELEVATIONS) {
    for (let turn = 0; turn < TURNS; turn++) {
      const direction = new Vector3().setFromSphericalCoords(1, Math.PI / 2 - elevation, (2 * Math.PI * turn) / TURNS);
      const shown = shownArea(direction, areas);
      if (shown > most) [best, most] = [direction, shown];
    }
  }
  return best;
}

/** Create a camera that orbits a model, controlled by pointer, wheel and keys; `onMove` is called after movements. */
export function orbitingCamera(canvas, onMove) {
  const camera = new PerspectiveCamera(FIELD_OF_VIEW, 1);
  const controls = new OrbitControls(camera, canvas);
  controls.zoomToCursor = true;
  // As in Blender: the middle button rotates, and with Shift pans.
  controls.mouseButtons.MIDDLE = controls.mouseButtons.LEFT;
  controls.addEventListener("change", onMove);
  const whole = new Sphere(new Vector3(), 1);
  const seen = new Sphere(new Vector3(), 1); // sphere that must be between the near and far planes
  let points = [new Vector3()]; // points of the model that the overview must include
  let others = []; // further points that the overview must include
  let look = FIRST_LOOK.clone(); // direction from the model to the camera in the overview

  /** Fit the near and far planes to the model. */
  function fitDepth() {
    const away = camera.position.distanceTo(seen.center);
    camera.near = Math.max(away - 1.05 * seen.radius, NEAREST * whole.radius);
    camera.far = away + 1.05 * seen.radius;
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
  }

  function place(eye, target) {
    camera.position.copy(eye);
    controls.target.copy(target);
    controls.update();
    fitDepth();
    onMove();
  }

  /** Move as close as all points of the model remain visible, for any aspect ratio. */
  function showAll() {
    const tall = Math.tan((camera.fov * Math.PI) / 360) / ROOM;
    const right = new Vector3(0, 1, 0).cross(look).normalize();
    const up = look.clone().cross(right);
    const [across, high] = [[right, tall * camera.aspect], [up, tall]].map(([axis, slope]) => {
      // |x - eye| <= slope (away - z) for all points bounds the camera position from both sides.
      const [lower, upper] = [-1, 1].map((side) =>
        [...points, ...others].reduce((most, point) => Math.max(most, (side * point.dot(axis)) / slope + point.dot(look)), -Infinity),
      );
      return { eye: (slope * (upper - lower)) / 2, away: (upper + lower) / 2 };
    });
    const away = Math.max(across.away, high.away);
    const at = (along) => new Vector3().addScaledVector(right, across.eye).addScaledVector(up, high.eye).addScaledVector(look, along);
    place(at(away), at(whole.center.dot(look)));
  }

  const keys = {
    ArrowLeft: (s) => (s.theta -= TURN),
    ArrowRight: (s) => (s.theta += TURN),
    ArrowUp: (s) => (s.phi -= TURN),
    ArrowDown: (s) => (s.phi += TURN),
    "+": (s) => (s.radius *= STEP),
    "=": (s) => (s.radius *= STEP),
    "-": (s) => (s.radius /= STEP),
  };
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "Home") showAll();
    else if (event.key in keys) {
      const offset = new Spherical().setFromVector3(camera.position.clone().sub(controls.target));
      keys[event.key](offset);
      place(controls.target.clone().add(new Vector3().setFromSpherical(offset.makeSafe())), controls.target.clone());
    } else return;
    event.preventDefault();
  });

  return {
    camera,
    fitDepth,
    showAll,
    /**
     * Set the model: its box in the scene, its mean normal `facing` if it was seen from one side, sample points
     * `known` of its surface, which replace the corners of the box, and area vectors of sampled triangles.
     */
    setModel(box, facing, known, areas = []) {
      points = known?.length ? known : cornersOf(box);
      const toward = facing ? intoScene(facing) : new Vector3();
      const front = new Vector3(toward.x, 0, toward.z);
      // A surface that faces up or down has no front side: keep the initial direction.
      const usual = front.length() > LEVEL ? front.normalize().setY(FIRST_LOOK.y / FIRST_LOOK.z).normalize() : FIRST_LOOK;
      look = chooseDirection(usual, areas);
      box.getBoundingSphere(whole);
      seen.copy(whole);
      controls.minDistance = NEAREST * whole.radius;
      controls.maxDistance = 100 * whole.radius;
    },
    /** Include further points in the overview and between the near and far planes. */
    include(further) {
      others = further;
      seen.copy(whole);
      for (const point of others) seen.expandByPoint(point);
      fitDepth();
    },
    resize(width, height) {
      camera.aspect = width / height;
      camera.updateProjectionMatrix();
    },
    set({ eye, target, fov }) {
      if (fov !== undefined) camera.fov = Math.min(fov, 150);
      const to = target ? intoScene(target) : controls.target.clone();
      place(eye ? intoScene(eye) : camera.position.clone(), to);
    },
    view: () => ({ eye: outOfScene(camera.position), target: outOfScene(controls.target), fov: camera.fov }),
  };
}
