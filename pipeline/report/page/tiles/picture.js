// The picture of a tileset: what is loaded, drawn again whenever something has changed, and only then.
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
const MOST_PIXELS = 2; // of the screen to one of the page: more are not seen

/** Of a tileset at the top of a server the library asks for //tiles/…, which not every server takes for /tiles/… */
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
 *   set({eye, target, fov, error, mode, wireframe}): any of them; positions in the tileset's frame, metres, z up;
 *     fov in degrees of the height; error in pixels; mode "colors" or "levels".
 *   settings(), view(): what is set, and from where it is seen.
 *   showAll(): see all of the model.
 *   settled(): a promise kept when all tiles that the view asks for are loaded and drawn.
 *   figures(): triangles, tilesDrawn, tilesLoaded, levels (drawn, by number), errorM (largest proven one, or null).
 *   onChange(call): called after each drawing.
 */
export function picture(canvas, address, { onReady, onError }) {
  const renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true });
  renderer.setPixelRatio(Math.min(devicePixelRatio, MOST_PIXELS));
  const settings = { ...DEFAULTS };
  const dressing = looks();
  const listeners = [];
  let wanted = {}; // a view that was asked for before there was anything to see
  let isPlaced = false;
  let hasShown = false;
  let scheduled = 0;
  let drawings = 0;

  const tiles = new TilesRenderer(address);
  tiles.registerPlugin(new GLTFExtensionsPlugin({ meshoptDecoder: MeshoptDecoder, metadata: false, rtc: false }));
  tiles.registerPlugin(singleSlash);
  // The root alone at first: something is seen after its few bytes.
  tiles.errorTarget = Infinity;
  tiles.group.rotation.x = -Math.PI / 2; // z up as y up
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
    // Before the camera stands somewhere, tiles would be chosen for nowhere: this only asks for the tileset.
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
      resize(); // the observer tells of a new size later
      orbit.showAll();
    },
    async settled() {
      // Quiet for some drawings: what is loaded in one is shown, or asks for more, in the next.
      for (let quiet = 0; quiet < 4; ) {
        const before = drawings;
        request();
        await new Promise(requestAnimationFrame);
        const { queued, downloading, parsing } = tiles.stats;
        const isQuiet = hasShown && drawings > before && !queued && !downloading && !parsing && tiles.visibleTiles.size;
        quiet = isQuiet ? quiet + 1 : 0;
      }
    },
    figures() {
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
