// Picture of the loaded tiles of a tileset, redrawn only after changes.
import {
  Box3,
  DirectionalLight,
  GLTFExtensionsPlugin,
  HemisphereLight,
  MeshoptDecoder,
  Scene,
  TilesRenderer,
  WebGLRenderer,
} from "../library.js";
import { orbitingCamera } from "./camera.js";
import { looks } from "./materials.js";

const DEFAULTS = { error: 2, mode: "colors", wireframe: false };
const MOST_PIXELS = 2; // maximum device pixels per CSS pixel: more make no visible difference

/** Normalise URLs: for a tileset at the root of a server, the library requests //tiles/…, which some servers reject. */
const singleSlash = {
  preprocessURL(address) {
    const url = new URL(address);
    url.pathname = url.pathname.replace(/^\/+/, "/");
    return url.href;
  },
};

/**
 * Draw the tileset at an address on a canvas.
 *
 * Returns
 *   set({eye, target, fov, error, mode, wireframe}): change any of these; positions in the frame of the tileset
 *     (metres, z up), vertical fov in degrees, error in pixels, mode "colors" or "levels".
 *   settings(), view(): return the current settings, and the current view.
 *   showAll(): view the whole model.
 *   settled(): return a promise that resolves after all tiles of the view are loaded and drawn.
 *   metrics(): return triangles, tilesDrawn, tilesLoaded, levels (drawn), errorM (largest proven error, or null).
 *   onChange(call): call a function after each drawing.
 */
export function picture(canvas, address, { onReady, onError }) {
  const renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true });
  renderer.setPixelRatio(Math.min(devicePixelRatio, MOST_PIXELS));
  const settings = { ...DEFAULTS };
  const dressing = looks();
  const listeners = [];
  let wanted = {}; // view requested before the tileset was loaded
  let isPlaced = false;
  let hasShown = false;
  let scheduled = 0;
  let drawings = 0;

  const tiles = new TilesRenderer(address);
  tiles.registerPlugin(new GLTFExtensionsPlugin({ meshoptDecoder: MeshoptDecoder, metadata: false, rtc: false }));
  tiles.registerPlugin(singleSlash);
  // Load only the root at first, because it is small and shows the model quickly.
  tiles.errorTarget = Infinity;
  tiles.group.rotation.x = -Math.PI / 2; // z up to y up
  const scene = new Scene();
  scene.add(tiles.group);
  const orbit = orbitingCamera(canvas, request);
  scene.add(orbit.camera, new HemisphereLight(0xffffff, 0x8f8f98, 2.2));
  const lamp = new DirectionalLight(0xffffff, 1.4); // from behind the viewer's left shoulder
  lamp.position.set(-0.4, 0.6, 0.8);
  orbit.camera.add(lamp);

  function request() {
    scheduled ||= requestAnimationFrame(draw);
  }

  function draw() {
    scheduled = 0;
    // Without a camera position no tiles can be selected: only request the tileset.
    if (!isPlaced) return tiles.update();
    orbit.fitDepth();
    tiles.update();
    renderer.render(scene, orbit.camera);
    drawings += 1;
    if (!hasShown && tiles.visibleTiles.size) {
      hasShown = true;
      tiles.errorTarget = settings.error;
      request();
    }
    listeners.forEach((call) => call());
  }

  function resize() {
    const { clientWidth: width, clientHeight: height } = canvas;
    if (!width || !height) return;
    renderer.setSize(width, height, false);
    orbit.resize(width, height);
    if (isPlaced) tiles.setResolution(orbit.camera, width, height);
    request();
  }

  function placeFirst() {
    if (isPlaced) return;
    tiles.group.updateMatrixWorld(true);
    const box = new Box3();
    tiles.getBoundingBox(box);
    orbit.setModel(box.applyMatrix4(tiles.group.matrixWorld), tiles.rootTileset.asset.extras?.facing);
    orbit.showAll();
    if (Object.keys(wanted).length) orbit.set(wanted);
    isPlaced = true;
    tiles.setCamera(orbit.camera);
    resize();
  }

  function redress() {
    tiles.forEachLoadedModel((model, tile) =>
      model.traverse((part) => part.isMesh && dressing.dress(part, tile.internal.depth, settings)),
    );
    request();
  }

  tiles.addEventListener("load-root-tileset", placeFirst);
  tiles.addEventListener("load-model", ({ scene: model, tile }) => {
    model.traverse((part) => part.isMesh && dressing.dress(part, tile.internal.depth, settings));
    onReady();
    request();
  });
  tiles.addEventListener("dispose-model", ({ scene: model }) => model.traverse((part) => dressing.undress(part)));
  tiles.addEventListener("load-error", ({ url }) => onError(`${url ?? address} could not be loaded.`));
  for (const change of ["needs-update", "tile-visibility-change", "tiles-load-end"]) {
    tiles.addEventListener(change, request);
  }
  new ResizeObserver(resize).observe(canvas);
  resize();

  return {
    set(changes) {
      const { eye, target, fov, ...others } = changes;
      Object.assign(settings, others);
      if (hasShown) tiles.errorTarget = settings.error;
      const view = Object.fromEntries(Object.entries({ eye, target, fov }).filter(([, value]) => value !== undefined));
      if (!isPlaced) wanted = { ...wanted, ...view };
      else if (Object.keys(view).length) orbit.set(view);
      redress();
    },
    settings: () => ({ ...settings }),
    view: orbit.view,
    showAll() {
      resize(); // the observer reports a new size later
      orbit.showAll();
    },
    async settled() {
      // Require several idle drawings: tiles loaded in one drawing may request more in the next.
      for (let quiet = 0; quiet < 4; ) {
        const before = drawings;
        request();
        await new Promise(requestAnimationFrame);
        const { queued, downloading, parsing } = tiles.stats;
        const isQuiet = hasShown && drawings > before && !queued && !downloading && !parsing && tiles.visibleTiles.size;
        quiet = isQuiet ? quiet + 1 : 0;
      }
    },
    metrics() {
      const drawn = [...tiles.visibleTiles].filter((tile) => tile.engineData.scene);
      const bounds = drawn.map((tile) => tile.content?.extras?.shape_bound_m ?? NaN);
      let triangles = 0;
      for (const tile of drawn) {
        tile.engineData.scene.traverse((part) => {
          if (part.isMesh) triangles += (part.geometry.index ?? part.geometry.attributes.position).count / 3;
        });
      }
      return {
        triangles,
        tilesDrawn: drawn.length,
        tilesLoaded: tiles.stats.loaded,
        levels: drawn.map((tile) => tile.internal.depth).sort((a, b) => a - b),
        errorM: drawn.length && bounds.every(Number.isFinite) ? Math.max(...bounds) : null,
      };
    },
    onChange: (call) => listeners.push(call),
  };
}
