"use strict";
// What all charts of a report share: the data, what is shown of it, elements, numbers, scales, legends.
// The four scripts stand on the page as one. Whatever came from the log is set as text, never as markup.

const { charts, spans, begin, end } = JSON.parse(document.getElementById("drawing").textContent);
const view = { begin, end, cursor: null }; // what all charts over time show
const all = []; // charts on the page; each has draw() and point(t)

// --- small tools ---------------------------------------------------------------------------------------------------------

const element = (name, attributes = {}, ...children) => {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
};
const html = (name, className, ...children) => {
  const made = document.createElement(name);
  made.className = className;
  made.append(...children);
  return made;
};
const label = (x, y, words, anchor = "middle") => element("text", { x, y, "text-anchor": anchor }, words);
const number = (x, digits = 4) => (x === 0 ? "0" : Math.abs(x) >= 1e5 || Math.abs(x) < 1e-3 ? x.toExponential(1) : String(+x.toPrecision(digits)));
const niceSteps = (low, high, wanted) => {
  const raw = (high - low) / wanted, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].find((k) => k * power >= raw) * power;
  const ticks = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k++) ticks.push(k * step);
  return ticks;
};
const SCALES = {
  linear: { to: (y) => y, ticks: (low, high, n) => niceSteps(low, high, n) },
  log: {
    to: (y) => Math.log10(Math.max(y, 1e-12)),
    ticks: (low, high) => {
      const ticks = [];
      for (let p = Math.floor(Math.log10(low)); p <= Math.log10(high); p++)
        for (const k of Math.log10(high / low) < 2 ? [1, 2, 5] : [1]) if (k * 10 ** p >= low && k * 10 ** p <= high) ticks.push(k * 10 ** p);
      return ticks;
    },
  },
};
const asinh = (linear) => ({
  to: (y) => Math.asinh((3 * y) / linear),
  ticks: (low, high) => {
    const most = Math.max(Math.abs(low), Math.abs(high)), ticks = [0];
    for (let v = linear; v <= most; v *= 10) ticks.push(v, -v);
    return ticks.filter((v) => v >= low && v <= high);
  },
});

// Outlines of marks, drawn from their middle.
const GLYPHS = {
  dot: "m-2.5 0a2.5 2.5 0 1 0 5 0a2.5 2.5 0 1 0 -5 0",
  diamond: "m0 -5l4 5l-4 5l-4 -5z",
  cross: "m-4 -4l8 8m0 -8l-8 8",
  plus: "m-4.5 0h9m-4.5 -4.5v9",
  tick: "m0 -5v10",
  top: "m0 -5v10",
  triangle: "m0 -7l6 11h-12z",
  square: "m-5 -5h10v10h-10z",
  line: "m-7 0h14",
  dashed: "m-7 0h14",
  ellipse: "m-6 0a6 3.5 0 1 0 12 0a6 3.5 0 1 0 -12 0",
};
const FILLED = new Set(["dot"]);
const swatch = (colour, shape) => {
  if (!GLYPHS[shape]) return html("i", colour);
  const kind = shape === "line" || shape === "dashed" ? `line ${shape}` : FILLED.has(shape) ? "point" : "mark";
  return element("svg", { class: "swatch", viewBox: "-8 -8 16 16" }, element("path", { class: `${kind} ${colour}`, d: `M0 0${GLYPHS[shape]}` }));
};

const legend = (figure, names, redraw) => {
  const hidden = new Set(), row = html("div", "legend");
  for (const [name, [colour, shape]] of new Map(names.map(([name, ...mark]) => [name, mark]))) {
    const key = html("button", "", swatch(colour, shape), name);
    key.type = "button";
    key.onclick = () => {
      if (!hidden.delete(name)) hidden.add(name);
      key.classList.toggle("off", hidden.has(name));
      redraw();
    };
    row.append(key);
  }
  figure.append(row);
  return hidden;
};
