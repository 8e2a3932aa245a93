// Where the picture is taken from. Positions outside this file are in the tileset's frame, metres, z up;
// three.js has y up.
import { OrbitControls, PerspectiveCamera, Sphere, Spherical, Vector3 } from "../library.js";

const FIELD_OF_VIEW = 50; // degrees, of the picture's height
// From the front and somewhat above, as z-up models are turned.
const FIRST_LOOK = new Vector3(0.45, 0.4, 1).normalize();
const LEVEL = 0.2; // of where a surface looks: less says nothing of a side
const ROOM = 1.15; // around the model when all of it is seen
const TURN = Math.PI / 36; // of an arrow key
const STEP = 0.85; // of + and -, a share of the distance
// Nothing nearer than this share of the model's radius is drawn: depth has few bits.
const NEAREST = 1e-3;

const intoScene = ([x, y, z]) => new Vector3(x, z, -y);
export const outOfScene = ({ x, y, z }) => [x, -z, y];
const cornersOf = ({ min, max }) =>
  [min.x, max.x].flatMap((x) => [min.y, max.y].flatMap((y) => [min.z, max.z].map((z) => new Vector3(x, y, z))));

/** A camera that orbits a model, moved by pointer, wheel and keys on a canvas; `onMove` is called when it has moved. */
export function orbitingCamera(canvas, onMove) {
  const camera = new PerspectiveCamera(FIELD_OF_VIEW, 1);
  const controls = new OrbitControls(camera, canvas);
  controls.zoomToCursor = true;
  controls.addEventListener("change", onMove);
  const whole = new Sphere(new Vector3(), 1);
  let points = [new Vector3()]; // that are to be seen when all of it is shown
  const look = FIRST_LOOK.clone(); // from the model to the eye, when all of it is shown

  /** Fit the depth that is drawn to the model. */
  function fitDepth() {
    const away = camera.position.distanceTo(whole.center);
    camera.near = Math.max(away - 1.05 * whole.radius, NEAREST * whole.radius);
    camera.far = away + 1.05 * whole.radius;
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

  /** Go as near as all of the model's points are seen, whatever the picture's shape. */
  function showAll() {
    const tall = Math.tan((camera.fov * Math.PI) / 360) / ROOM;
    const right = new Vector3(0, 1, 0).cross(look).normalize();
    const up = look.clone().cross(right);
    const [across, high] = [[right, tall * camera.aspect], [up, tall]].map(([axis, slope]) => {
      // |x - eye| <= slope (away - z) for all points: both sides bound where the eye is.
      const [lower, upper] = [-1, 1].map((side) =>
        points.reduce((most, point) => Math.max(most, (side * point.dot(axis)) / slope + point.dot(look)), -Infinity),
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
     * Tell what there is to be seen: a box in the scene, where its surface looks, if it was seen from one side, and
     * points of it, if it is known better than by its corners.
     */
    setModel(box, facing, known) {
      points = known?.length ? known : cornersOf(box);
      const toward = facing ? intoScene(facing) : new Vector3();
      const front = new Vector3(toward.x, 0, toward.z);
      // What looks up or down is seen as all else is.
      if (front.length() > LEVEL) look.copy(front.normalize()).setY(FIRST_LOOK.y / FIRST_LOOK.z).normalize();
      box.getBoundingSphere(whole);
      controls.minDistance = NEAREST * whole.radius;
      controls.maxDistance = 100 * whole.radius;
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
