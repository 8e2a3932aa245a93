// Alternative colourings of a model: vertex colours, or a scalar per vertex with a colour scale.
import { BufferGeometry, DataTexture, DoubleSide, Float32BufferAttribute, Group, Mesh, MeshBasicMaterial, SRGBColorSpace, Color, Vector3 } from "../library.js";

// Names that GLTFLoader gives to the attributes _VALUES and _COLOR_DISPLAYED.
const VALUES = "_values";
const COLORS = "_color_displayed";
// Weak shading that shows the shape; stronger shading would distort the colour scale.
const LIGHT = new Vector3(0.35, 0.8, 0.45).normalize();
const SHADE = 0.24;

/** Create a recoloured copy of a loaded scene, sharing its geometry. */
export function inLook(loaded, look, scale) {
  const made = new Group();
  loaded.updateMatrixWorld(true);
  loaded.traverse((one) => {
    if (!one.isMesh) return;
    const painted = look === "colors" ? inVertexColors(one.geometry) : inValues(one.geometry, one.matrixWorld, look, scale);
    painted.matrixAutoUpdate = false;
    painted.matrix.copy(one.matrixWorld);
    made.add(painted);
  });
  return made;
}

/** Replace the colours of a scene with a colour scale. */
export function recolor(made, colors) {
  made.traverse((one) => {
    if (!one.isMesh || !one.userData.palette) return;
    one.userData.palette.image.data.set(texels(colors));
    one.userData.palette.needsUpdate = true;
  });
}

function shape(geometry) {
  const made = new BufferGeometry();
  made.setAttribute("position", geometry.attributes.position);
  return made.setIndex(geometry.index);
}

function inVertexColors(geometry) {
  const found = geometry.attributes[COLORS];
  const colors = new Float32Array(3 * found.count);
  const color = new Color();
  for (let k = 0; k < found.count; k++) {
    color.setRGB(found.getX(k), found.getY(k), found.getZ(k), SRGBColorSpace).toArray(colors, 3 * k);
  }
  const made = shape(geometry).setAttribute("color", new Float32BufferAttribute(colors, 3));
  return new Mesh(made, new MeshBasicMaterial({ vertexColors: true, side: DoubleSide }));
}

// The colour is looked up per fragment instead of per vertex, so that steps stay sharp.
function inValues(geometry, matrix, channel, { colors }) {
  const found = geometry.attributes[VALUES];
  const places = new Float32Array(2 * found.count).fill(0.5);
  for (let k = 0; k < found.count; k++) places[2 * k] = found.getComponent(k, channel);
  const palette = new DataTexture(texels(colors), colors.length, 1);
  palette.colorSpace = SRGBColorSpace;
  palette.needsUpdate = true;
  const made = shape(geometry).setAttribute("uv", new Float32BufferAttribute(places, 2));
  made.setAttribute("color", new Float32BufferAttribute(shades(made, matrix), 3));
  const mesh = new Mesh(made, new MeshBasicMaterial({ map: palette, vertexColors: true, side: DoubleSide }));
  mesh.userData.palette = palette;
  return mesh;
}

function shades(geometry, matrix) {
  geometry.computeVertexNormals();
  const { normal } = geometry.attributes;
  const direction = new Vector3();
  const shades = new Float32Array(3 * normal.count);
  for (let k = 0; k < normal.count; k++) {
    const lit = Math.abs(direction.fromBufferAttribute(normal, k).transformDirection(matrix).dot(LIGHT));
    shades.fill((1 - SHADE * (1 - lit)) ** 2.2, 3 * k, 3 * k + 3);
  }
  geometry.deleteAttribute("normal");
  return shades;
}

const texels = (colors) => new Uint8Array(colors.flatMap((color) => [...color.match(/\d+/g).map(Number), 255]));
