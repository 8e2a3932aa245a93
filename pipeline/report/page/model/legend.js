// Colour scale of a model, with a histogram of its surface.

const CLOSE = 0.06; // minimum distance of two labels, as a ratio of the scale

/** Show the scale `name` in an element, highest value first, with colour-blind safe colours if `safe`; hide it without a scale. */
export function legend(place, scale, name, safe = false) {
  place.replaceChildren();
  place.hidden = !scale;
  if (!scale) return;
  const { unit, low, high, shares, within, marks: given } = scale;
  const colors = safe && scale.safe ? scale.safe : scale.colors;
  const number = given ? plain : signed;
  const most = Math.max(...shares);
  const bars = element("div", "bars");
  bars.setAttribute("role", "img");
  bars.setAttribute("aria-label", `Histogram of the surface in ${unit} from ${number(given ? given[0] : low)} to ${number(given ? given.at(-1) : high)}: ${summary(scale)}`);
  for (let at = colors.length - 1; at >= 0; at--) {
    const row = element("div", "bin");
    row.title = `${(100 * shares[at]).toPrecision(2)} % of the surface`;
    const swatch = element("span", "swatch");
    swatch.style.background = colors[at];
    const bar = element("span", "share");
    bar.style.width = `${(100 * shares[at]) / most}%`;
    const track = element("span", "track");
    track.append(bar);
    row.append(swatch, track);
    bars.append(row);
  }
  const marks = element("div", "marks");
  const wanted = given ?? (low < 0 ? [high, low, within, -within, 0] : [high, low, within]).filter((value) => value !== null);
  const told = [];
  for (const value of wanted) {
    // Skip labels that would overlap.
    if (told.some((other) => Math.abs(other - value) < CLOSE * (high - low))) continue;
    told.push(value);
    const mark = element("span", "mark");
    mark.style.top = `${(100 * (high - value)) / (high - low)}%`;
    mark.textContent = number(value);
    marks.append(mark);
  }
  const title = element("div", "unit");
  title.textContent = `${unit} · ${name}`;
  place.append(title, bars, marks);
}

const plain = (value) => `${Number(value.toPrecision(3))}`;
const signed = (value) => (value > 0 ? "+" : "") + plain(value);

/** Describe the histogram in words, for screen readers. */
function summary({ low, high, shares, unit }) {
  const step = (high - low) / shares.length;
  const most = shares.indexOf(Math.max(...shares));
  return `most common, ${(100 * shares[most]).toPrecision(2)} % of the surface, near ${plain(low + (most + 0.5) * step)} ${unit}`;
}

function element(kind, name) {
  const made = document.createElement(kind);
  made.className = name;
  return made;
}
