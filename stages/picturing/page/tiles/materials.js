// How tiles look: as they are, or a colour for each level, which shows where one ends.
import { Color, DoubleSide, MeshLambertMaterial } from "../library.js";

// From the root on: apart from each other for eyes that tell no red from green, too.
const LEVELS = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#999999"];

/** The looks of all tiles; `dress` gives a mesh of some level the one that is chosen. */
export function looks() {
  const ofLevel = LEVELS.map(
    (color) => new MeshLambertMaterial({ color: new Color(color), side: DoubleSide, flatShading: true }),
  );
  const own = new WeakMap();
  return {
    dress(mesh, level, { mode, wireframe }) {
      if (!own.has(mesh)) own.set(mesh, mesh.material);
      mesh.material = mode === "levels" ? ofLevel[level % LEVELS.length] : own.get(mesh);
      mesh.material.wireframe = wireframe;
    },
    /** Give back what the tile came with, which its renderer puts away. */
    undress(mesh) {
      if (own.has(mesh)) mesh.material = own.get(mesh);
    },
  };
}
