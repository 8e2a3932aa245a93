// Cameras of a scan, drawn as pyramids, and the photo of one camera as an overlay seen from its position.
import { BufferGeometry, Color, DoubleSide, Float32BufferAttribute, LineBasicMaterial, LineSegments, Mesh, MeshBasicMaterial, SRGBColorSpace, Texture, Vector3 } from "../library.js";

const SIZE = 0.035; // height of a pyramid, as a ratio of the model size
const LINE = "#1f6fc8";
const CHOSEN = "#e6009e";

/** Convert a camera of the page to the scene: position `eye`, and image `corners` at 1 m depth. */
function placed({ pose, size, focal, center }) {
  const at = (x, y, z) => {
    const world = [0, 1, 2].map((row) => pose[4 * row] * x + pose[4 * row + 1] * y + pose[4 * row + 2] * z + pose[4 * row + 3]);
    return new Vector3(world[0], world[2], -world[1]);
  };
  const edge = ([u, v]) => at((u - 0.5 - center[0]) / focal[0], (v - 0.5 - center[1]) / focal[1], 1);
  const corners = [[0, 0], [size[0], 0], [size[0], size[1]], [0, size[1]]].map(edge);
  return { eye: at(0, 0, 0), ahead: at(0, 0, 1), corners };
}

/** Create the scene objects of the cameras; `change` is called after a photo has loaded. */
export function camerasOf(cameras, scene, change) {
  const all = cameras.map(placed);
  const lines = new LineSegments(new BufferGeometry(), new LineBasicMaterial({ vertexColors: true }));
  const slide = new Mesh(
    new BufferGeometry(),
    new MeshBasicMaterial({ side: DoubleSide, transparent: true, depthTest: false, depthWrite: false, toneMapped: false }),
  );
  slide.renderOrder = 1;
  lines.visible = slide.visible = false;
  lines.frustumCulled = slide.frustumCulled = false;
  scene.add(lines, slide);
  const read = new Map();
  let long = 1;
  let wanted = null;

  function color(chosen) {
    const colors = all.flatMap((_, number) => Array(16).fill(new Color(number === chosen ? CHOSEN : LINE).toArray()).flat());
    lines.geometry.setAttribute("color", new Float32BufferAttribute(colors, 3));
  }

  function build(modelSize) {
    long = SIZE * modelSize;
    const places = all.flatMap(({ eye, corners }) => {
      const far = corners.map((corner) => corner.clone().sub(eye).multiplyScalar(long).add(eye));
      return far.flatMap((corner, k) => [eye, corner, corner, far[(k + 1) % 4]]).flatMap((point) => point.toArray());
    });
    lines.geometry.setAttribute("position", new Float32BufferAttribute(places, 3));
    color(null);
  }

  async function show(number, depth) {
    wanted = number;
    color(number);
    slide.visible = false;
    if (number === null || !cameras[number].photo) return;
    if (!read.has(number)) {
      const image = new Image();
      image.src = cameras[number].photo;
      await image.decode();
      const texture = new Texture(image);
      texture.colorSpace = SRGBColorSpace;
      texture.needsUpdate = true;
      read.set(number, texture);
    }
    if (wanted !== number) return;
    const { eye, corners } = all[number];
    const [a, b, c, d] = corners.map((corner) => corner.clone().sub(eye).multiplyScalar(depth).add(eye).toArray());
    slide.geometry.setAttribute("position", new Float32BufferAttribute([a, d, c, a, c, b].flat(), 3));
    slide.geometry.setAttribute("uv", new Float32BufferAttribute([0, 1, 0, 0, 1, 0, 0, 1, 1, 0, 1, 1], 2));
    slide.material.map = read.get(number);
    slide.material.needsUpdate = true;
    slide.visible = true;
    change();
  }

  return {
    all,
    build,
    show,
    set visible(value) {
      lines.visible = value;
    },
    set opacity(value) {
      slide.material.opacity = value;
    },
    /** Return the index of the nearest camera whose pyramid a ray hits; null if none. */
    under(ray) {
      let [found, least] = [null, Infinity];
      all.forEach(({ eye, corners }, number) => {
        const middle = corners.reduce((sum, corner) => sum.add(corner.clone().sub(eye)), new Vector3());
        middle.multiplyScalar((0.6 * long) / 4).add(eye);
        const along = middle.clone().sub(ray.origin).dot(ray.direction);
        if (along > 0 && along < least && ray.distanceToPoint(middle) < 0.7 * long) [found, least] = [number, along];
      });
      return found;
    },
  };
}
