// Measurements and notes on the surface: distances, angles, areas and texts, kept until they are deleted.
import { BufferGeometry, Float32BufferAttribute, Group, LineBasicMaterial, LineSegments, Points, PointsMaterial, Vector3 } from "../library.js";
import { formatAngle, formatArea, formatLength } from "./lengths.js";

// Transparent materials are drawn last, over the photo of a camera.
const PAINT = { color: "#e6009e", depthTest: false, transparent: true };

// `count`: points of a complete measurement; an area ends on request.
const KINDS = {
  distance: { name: "Distance", count: 2, unit: (unit) => unit, prompts: ["Click two points of the surface.", "Now the second point."], format: formatLength },
  angle: { name: "Angle", count: 3, unit: () => "deg", prompts: ["Click a point on the first side.", "Now the corner.", "Now a point on the second side."], format: formatAngle },
  area: { name: "Area", count: Infinity, unit: (unit) => `${unit}2`, prompts: ["Click the corners of a flat area.", "Now the next corner.", "Now the next corner.", "Add corners, or close the area."], format: formatArea },
  note: { name: "Note", count: 1, unit: () => null, prompts: ["Click the point that the note is about."], format: () => "" },
};

/** Compute the value of a measurement: metres, square metres or degrees; null for a note. */
function measure(kind, points) {
  if (kind === "distance") return points[0].distanceTo(points[1]);
  if (kind === "angle") {
    const [first, second] = [points[0], points[2]].map((point) => point.clone().sub(points[1]));
    return (first.angleTo(second) * 180) / Math.PI;
  }
  if (kind !== "area") return null;
  // Half the sum of cross products is the area of the polygon, projected to its mean plane.
  const sum = new Vector3();
  const offsets = points.map((point) => point.clone().sub(points[0]));
  offsets.forEach((offset, index) => sum.add(offset.clone().cross(offsets[(index + 1) % offsets.length])));
  return sum.length() / 2;
}

/** Create the measurements of a scene; `change` is called after every edit. */
export function createMeasurements(scene, unit, change) {
  const entries = [];
  let pending = [];
  let kind = "distance";
  const marks = new Group();
  scene.add(marks);

  function add(points) {
    entries.push({ kind, points, value: measure(kind, points), text: "" });
    pending = [];
  }

  function draw() {
    marks.traverse((one) => one.geometry?.dispose());
    marks.clear();
    for (const { kind: shape, points } of [...entries, { kind, points: pending }]) {
      if (!points.length) continue;
      // Offsets from the first point are exact in single precision at map coordinates too.
      const offsets = points.map((point) => point.clone().sub(points[0]).toArray());
      const ends = offsets.slice(1).flatMap((offset, index) => [offsets[index], offset]);
      if (shape === "area" && points !== pending) ends.push(offsets.at(-1), offsets[0]);
      const group = new Group();
      group.position.copy(points[0]);
      group.add(
        new Points(geometryOf(offsets), new PointsMaterial({ ...PAINT, size: 9, sizeAttenuation: false })),
        new LineSegments(geometryOf(ends), new LineBasicMaterial(PAINT)),
      );
      group.children.forEach((one) => (one.renderOrder = 2));
      marks.add(group);
    }
  }

  function edited() {
    draw();
    change();
  }

  return {
    kinds: Object.entries(KINDS).map(([key, { name }]) => [key, name]),
    entries,
    nameOf: ({ kind: shape }) => KINDS[shape].name,
    format: ({ kind: shape, value }) => KINDS[shape].format(value, unit),
    middleOf: ({ points }) => points.reduce((sum, point) => sum.add(point), new Vector3()).divideScalar(points.length),
    pending: () => pending,
    kind: () => kind,
    prompt: () => KINDS[kind].prompts[Math.min(pending.length, KINDS[kind].prompts.length - 1)],
    canFinish: () => kind === "area" && pending.length > 2,
    choose(wanted) {
      kind = wanted;
      pending = [];
      edited();
    },
    addPoint(point) {
      pending.push(point);
      if (pending.length >= KINDS[kind].count) add(pending);
      edited();
    },
    finish() {
      if (kind === "area" && pending.length > 2) add(pending);
      edited();
    },
    cancel() {
      if (!pending.length) return;
      pending = [];
      edited();
    },
    remove(entry) {
      entries.splice(entries.indexOf(entry), 1);
      edited();
    },
    /** Set the text of an entry. */
    annotate(entry, text) {
      entry.text = text;
      change();
    },
    /** Return the measurements as JSON-ready values; `toScan` converts a point to scan coordinates. */
    list: (toScan) =>
      entries.map(({ kind: shape, points, value, text }) => ({ kind: shape, text, value, unit: KINDS[shape].unit(unit), points: points.map(toScan) })),
  };
}

function geometryOf(offsets) {
  return new BufferGeometry().setAttribute("position", new Float32BufferAttribute(offsets.flat(), 3));
}
