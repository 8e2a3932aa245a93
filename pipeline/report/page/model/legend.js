// What the colours of a model stand for, and how much of its surface has each.

const CLOSE = 0.06; // of the scale, two numbers

/** Fill an element with a scale, highest first, in colours that all eyes tell apart if wanted; hide it without one. */
export function legend(place, scale, safe = false) {
  place.replaceChildren();
  place.hidden = !scale;
  if (!scale) return;
  const { unit, low, high, shares, within, marks: given } = scale;
  const colors = safe && scale.safe ? scale.safe : scale.colors;
  const number = given ? plain : signed;
  const most = Math.max(...shares);
  const bars = element("div", "bars");
  bars.setAttribute("role", "img");
  bars.setAttribute("aria-label", `Share of the surface for ${unit} from ${number(given ? given[0] : low)} to ${number(given ? given.at(-1) : high)}: ${summary(scale)}`);
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
    // What would be written over another is left out.
    if (told.some((other) => Math.abs(other - value) < CLOSE * (high - low))) continue;
    told.push(value);
    const mark = element("span", "mark");
    mark.style.top = `${(100 * (high - value)) / (high - low)}%`;
    mark.textContent = number(value);
    marks.append(mark);
  }
  const title = element("div", "unit");
  title.textContent = unit;
  place.append(title, bars, marks);
}

const plain = (value) => `${Number(value.toPrecision(3))}`;
const signed = (value) => (value > 0 ? "+" : "") + plain(value);

/** Say in words what the bars show: where most of the surface is. */
function summary({ low, high, shares, unit }) {
  const step = (high - low) / shares.length;
  const most = shares.indexOf(Math.max(...shares));
  return `most of it, ${(100 * shares[most]).toPrecision(2)} %, near ${plain(low + (most + 0.5) * step)} ${unit}`;
}

function element(kind, name) {
  const made = document.createElement(kind);
  made.className = name;
  return made;
}
