// Lengths, areas and angles as text. Files and scans use metres; people read millimetres.

/** Format a length; below one metre in millimetres. */
export function formatLength(value, unit) {
  if (unit !== "m" || value >= 1) return `${format(value)} ${unit}`;
  return `${format(1000 * value)} mm`;
}

/** Format an area; below 0.1 m² in cm². */
export function formatArea(value, unit) {
  if (unit !== "m" || value >= 0.1) return `${format(value)} ${unit}²`;
  return `${format(1e4 * value)} cm²`;
}

export const formatAngle = (value) => `${value.toFixed(1)}°`;

const format = (value) => String(value < 1000 ? Number(value.toPrecision(4)) : Math.round(value));
