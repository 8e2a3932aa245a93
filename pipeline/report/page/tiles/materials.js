// Materials of tiles: their own, or one colour per level of detail.
import { Color, DoubleSide, MeshBasicMaterial, MeshLambertMaterial } from "../library.js";

// Colours by level, root first; distinguishable for the colour-blind.
const LEVELS = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#999999"];
const BARE = "#7f8894"; // wireframe of a mesh without colours, visible on light and dark backgrounds

/** Create the materials of all tiles; `dress` assigns the chosen material to a mesh of a level. */
export function looks() {
  const ofLevel = LEVELS.map(
    (color) => new MeshLambertMaterial({ color: new Color(color), side: DoubleSide, flatShading: true }),
  );
  // Wireframes are unlit, because lines have no normals.
  const lines = [...LEVELS, BARE].map((color) => new MeshBasicMaterial({ color: new Color(color), wireframe: true }));
  const own = new WeakMap();

  function chosen(material, number, { mode, wireframe }) {
    if (mode === "levels") return (wireframe ? lines : ofLevel)[number];
    if (wireframe && !material.isMeshBasicMaterial) return lines.at(-1);
    material.wireframe = wireframe;
    return material;
  }

  return {
    dress(mesh, level, settings) {
      if (!own.has(mesh)) own.set(mesh, mesh.material);
      mesh.material = chosen(own.get(mesh), level % LEVELS.length, settings);
    },
    /** Restore the original material, so that the tile renderer can dispose of it. */
    undress(mesh) {
      if (own.has(mesh)) mesh.material = own.get(mesh);
    },
  };
}
