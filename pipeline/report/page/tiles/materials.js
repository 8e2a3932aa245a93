// How tiles look: as they are, or a colour for each level, which shows where one ends.
import { Color, DoubleSide, MeshBasicMaterial, MeshLambertMaterial } from "../library.js";

// From the root on: apart from each other for eyes that tell no red from green, too.
const LEVELS = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#999999"];
const BARE = "#7f8894"; // lines of a mesh without colours, on light and dark paper

/** The looks of all tiles; `dress` gives a mesh of some level the one that is chosen. */
export function looks() {
  const ofLevel = LEVELS.map(
    (color) => new MeshLambertMaterial({ color: new Color(color), side: DoubleSide, flatShading: true }),
  );
  // Lines have no side that light could fall on.
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
    /** Give back what the tile came with, which its renderer puts away. */
    undress(mesh) {
      if (own.has(mesh)) mesh.material = own.get(mesh);
    },
  };
}
