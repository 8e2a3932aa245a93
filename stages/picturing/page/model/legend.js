// What the colours of a model stand for, and how much of its surface has each.

const CLOSE = 0.06; // of the scale, two numbers

/** Fill an element with a scale, highest first; hide it where a model has none. */
export function legend(place, scale) {
  place.replaceChildren();
  place.hidden = !scale;
  if (!scale) return;
  const { unit, low, high, colors, shares, within } = scale;
  const most = Math.max(...shares);
  const bars = element("div", "bars");
  bars.setAttribute("role", "img");
  bars.setAttribute("aria-label", `Histogram from ${number(low)} to ${number(high)} ${unit}`);
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
  const wanted = low < 0 ? [high, low, within, -within, 0] : [high, low, within];
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

const number = (value) => (value > 0 ? "+" : "") + Number(value.toPrecision(3));

function element(kind, name) {
  const made = document.createElement(kind);
  made.className = name;
  return made;
}
