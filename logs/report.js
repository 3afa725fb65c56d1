"use strict";
// Draws the charts that logs/report_charts.py describes. All charts over time show the same time; whatever came from the log is set
// as text, never as markup.
(() => {
  const { charts, spans, begin, end } = JSON.parse(document.getElementById("drawing").textContent);
  const view = { begin, end, cursor: null }; // what all charts over time show
  const all = []; // charts on the page; each has draw() and point(t)
  let map = null;

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

  const legend = (figure, names, redraw) => {
    const hidden = new Set(), row = html("div", "legend");
    for (const [name, colour] of new Map(names)) {
      const key = html("button", "", html("i", colour), name);
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

  // --- charts over time ----------------------------------------------------------------------------------------------------

  const LEFT = 58, RIGHT = 10, TOP = 8, BOTTOM = 22, ROW = 30;

  class OverTime {
    constructor(figure, chart) {
      Object.assign(this, { figure, chart, height: chart.height || ROW * Object.keys(chart.rows || {}).length + TOP + BOTTOM });
      figure.append(html("figcaption", "", chart.title + (chart.unit ? ` [${chart.unit}]` : "")));
      this.hidden = chart.parts ? legend(figure, chart.parts.map((p) => [p.name, p.colour]), () => this.draw()) : new Set();
      this.readout = html("div", "readout");
      this.svg = element("svg", { role: "img", "aria-label": chart.title });
      figure.append(this.readout, this.svg);
      this.listen();
    }

    time(event) {
      const box = this.svg.getBoundingClientRect();
      const x = ((event.clientX - box.left) / box.width) * this.width;
      return view.begin + ((x - LEFT) / (this.width - LEFT - RIGHT)) * (view.end - view.begin);
    }

    listen() {
      let from = null;
      this.svg.onpointerdown = (event) => {
        from = this.time(event);
        this.svg.setPointerCapture(event.pointerId);
      };
      this.svg.onpointermove = (event) => {
        point(this.time(event));
        if (from !== null) this.shade(from, this.time(event));
      };
      this.svg.onpointerup = (event) => {
        const until = this.time(event), width = Math.abs(until - from);
        if (from !== null && width > 0.01 * (view.end - view.begin)) show(Math.min(from, until), Math.max(from, until));
        else this.shade(0, 0);
        from = null;
      };
      this.svg.onpointerleave = () => point(null);
      this.svg.ondblclick = () => show(begin, end);
    }

    x(t) {
      return LEFT + ((t - view.begin) / (view.end - view.begin)) * (this.width - LEFT - RIGHT);
    }

    shade(from, until) {
      this.svg.querySelector(".zoom")?.remove();
      if (from === until) return;
      const [a, b] = [this.x(Math.min(from, until)), this.x(Math.max(from, until))];
      this.svg.append(element("rect", { class: "zoom", x: a, y: TOP, width: b - a, height: this.height - TOP - BOTTOM }));
    }

    frame() {
      this.width = Math.max(280, this.figure.clientWidth);
      const inner = { x: LEFT, y: TOP, width: this.width - LEFT - RIGHT, height: this.height - TOP - BOTTOM };
      const name = `clip${all.indexOf(this)}`, body = element("g", { "clip-path": `url(#${name})` });
      const clip = element("clipPath", { id: name }, element("rect", inner));
      for (const span of spans)
        body.append(element("rect", { class: "span", x: this.x(span.start), y: TOP, width: Math.max(1, this.x(span.end) - this.x(span.start)), height: inner.height }));
      this.svg.setAttribute("viewBox", `0 0 ${this.width} ${this.height}`);
      this.svg.replaceChildren(clip, element("rect", { class: "grid", ...inner }), body);
      for (const t of niceSteps(view.begin, view.end, this.width / 110)) {
        this.svg.append(label(this.x(t), this.height - 7, number(t, 6)));
        body.append(element("path", { class: "grid", d: `M${this.x(t)} ${TOP}V${this.height - BOTTOM}` }));
      }
      this.svg.append(label(this.width - RIGHT, this.height - 7, "s", "end"));
      return body;
    }

    point(t) {
      this.svg.querySelector(".cursor")?.remove();
      this.readout.textContent = "";
      if (t === null || t < view.begin || t > view.end) return;
      this.svg.append(element("path", { class: "cursor", d: `M${this.x(t)} ${TOP}V${this.height - BOTTOM}` }));
      const told = [`${number(t, 6)} s`, ...this.told(t)];
      for (const span of spans) if (span.start <= t && t <= span.end) told.push(span.name);
      this.readout.textContent = told.join("  ·  ");
    }
  }

  const at = (part, t) => Math.round((t - part.start) / part.step);

  class TimeChart extends OverTime {
    shown() {
      return this.chart.parts.filter((part) => !this.hidden.has(part.name));
    }

    range() {
      let low = Infinity, high = -Infinity;
      const log = this.chart.scale === "log";
      const take = (y) => {
        if (y === null || y === undefined || (log && y <= 0)) return;
        low = Math.min(low, y);
        high = Math.max(high, y);
      };
      for (const part of this.shown()) {
        if (part.type === "points") {
          if (part.shape !== "tick" && part.shape !== "top") part.t.forEach((t, k) => t >= view.begin && t <= view.end && take(part.y[k]));
        } else {
          const last = Math.min(part.low.length - 1, at(part, view.end));
          for (let k = Math.max(0, at(part, view.begin)); k <= last; k++) take(part.low[k]), take(part.high[k]);
        }
      }
      for (const level of this.chart.levels) take(level.y);
      if (low > high) return log ? [0.1, 10] : [-1, 1];
      if (log) return [Math.max(low, high / 1e5) / 1.3, high * 1.3]; // a single tiny value does not squeeze the rest
      const room = Math.max(0.06 * (high - low), 1e-9 * Math.abs(high), 1e-12);
      return [low - room, high + room];
    }

    draw() {
      const body = this.frame(), [low, high] = this.range(), inner = this.height - TOP - BOTTOM;
      const scale = this.chart.scale === "asinh" ? asinh(this.chart.linear) : SCALES[this.chart.scale];
      const [bottom, top] = [scale.to(low), scale.to(high)];
      const y = (value) => TOP + inner * (1 - (scale.to(value) - bottom) / (top - bottom));
      let above = Infinity;
      for (const tick of scale.ticks(low, high, inner / 28).sort((a, b) => a - b)) {
        body.append(element("path", { class: "grid", d: `M${LEFT} ${y(tick)}H${this.width - RIGHT}` }));
        if (above - y(tick) > 12) this.svg.append(label(LEFT - 5, (above = y(tick)) + 4, number(tick), "end"));
      }
      for (const part of this.shown()) this[part.type](body, part, y);
      for (const level of this.chart.levels) {
        body.append(element("path", { class: "level", d: `M${LEFT} ${y(level.y)}H${this.width - RIGHT}` }));
        body.append(label(this.width - RIGHT - 3, y(level.y) + (y(level.y) < TOP + 14 ? 12 : -3), level.name, "end"));
      }
      this.point(view.cursor);
    }

    stretches(part) {
      // runs of spans that have a value, as far as they are in view; a single empty span does not break a line
      const runs = [], last = Math.min(part.low.length - 1, at(part, view.end) + 1);
      let run = [];
      for (let k = Math.max(0, at(part, view.begin) - 1), missing = 0; k <= last; k++) {
        if (part.low[k] === null) {
          if (++missing * part.step > 0.5 && run.length) runs.push(run), (run = []);
          continue;
        }
        missing = 0;
        run.push(k);
      }
      if (run.length) runs.push(run);
      return runs;
    }

    line(body, part, y) {
      const d = this.stretches(part).map((run) => {
        let path = "", pen = "M";
        for (const k of run) {
          const x = this.x(part.start + k * part.step).toFixed(1), [a, b] = [y(part.low[k]).toFixed(1), y(part.high[k]).toFixed(1)];
          path += a === b ? `${pen}${x} ${a}` : `${pen}${x} ${a}V${b}`;
          pen = "L";
        }
        return path;
      });
      body.append(element("path", { class: `line ${part.colour}`, d: d.join("") }));
    }

    band(body, part, y) {
      const d = this.stretches(part).map((run) => {
        const corner = (edge) => (k) => `${this.x(part.start + k * part.step).toFixed(1)} ${y(edge[k]).toFixed(1)}`;
        return `M${run.map(corner(part.high)).join("L")}L${run.reverse().map(corner(part.low)).join("L")}Z`;
      });
      body.append(element("path", { class: `band ${part.colour}`, d: d.join("") }));
    }

    points(body, part, y) {
      const edge = { tick: this.height - BOTTOM - 8, top: TOP + 8 }[part.shape];
      let d = "";
      part.t.forEach((t, k) => {
        if (t < view.begin || t > view.end || (part.y[k] === null && !edge)) return;
        const px = this.x(t).toFixed(1), py = (edge ?? y(part.y[k])).toFixed(1);
        d += edge ? `M${px} ${py - 5}v10` : part.shape === "dot" ? `M${px - 2} ${py}a2 2 0 1 0 4 0a2 2 0 1 0 -4 0` : `M${px - 3} ${py - 3}l6 6m0 -6l-6 6`;
      });
      body.append(element("path", { class: `${part.shape === "dot" ? "point" : "mark"} ${part.colour}`, d }));
    }

    told(t) {
      const near = (4 / this.width) * (view.end - view.begin), words = [];
      for (const part of this.shown()) {
        if (part.type === "points") {
          let best = -1;
          part.t.forEach((u, k) => Math.abs(u - t) <= (best < 0 ? near : Math.abs(part.t[best] - t)) && (best = k));
          if (best >= 0) words.push(`${part.name}${part.text[best] ? ": " + part.text[best] : part.y[best] === null ? "" : " " + number(part.y[best])}`);
          continue;
        }
        const k = at(part, t), [low, high] = [part.low[k], part.high[k]];
        if (low === null || low === undefined) continue;
        const turned = (v) => number(part.turn ? ((v % part.turn) + part.turn) % part.turn : v);
        words.push(`${part.name} ${part.type === "band" || high - low > 0.02 * Math.abs(high) ? `${turned(low)} … ${turned(high)}` : turned((low + high) / 2)}`);
      }
      return words;
    }
  }

  class StripChart extends OverTime {
    draw() {
      const body = this.frame();
      Object.entries(this.chart.rows).forEach(([name, stays], row) => {
        const top = TOP + ROW * row;
        for (const stay of stays) {
          const a = this.x(stay.start), width = Math.max(1.5, this.x(stay.end) - a);
          body.append(element("rect", { class: `stay ${stay.colour}`, x: a, y: top + 15, width, height: 12 }));
        }
        this.svg.append(label(LEFT + 2, top + 11, name, "start"));
      });
      this.point(view.cursor);
    }

    told(t) {
      return Object.entries(this.chart.rows).flatMap(([name, stays]) => {
        const stay = stays.find((s) => s.start <= t && t < s.end);
        return stay ? [`${name}: ${stay.text}`] : [];
      });
    }
  }

  // --- bars ----------------------------------------------------------------------------------------------------------------

  class BarChart {
    constructor(figure, chart) {
      Object.assign(this, { figure, chart });
      this.svg = element("svg", { role: "img", "aria-label": chart.title });
      this.readout = html("div", "readout");
      figure.append(html("figcaption", "", `${chart.title} [${chart.unit}]`), this.readout, this.svg);
    }

    draw() {
      const width = Math.max(280, this.figure.clientWidth), height = 170, { edges, counts, colour } = this.chart;
      const used = counts.flatMap((n, k) => (n ? [k] : []));
      const first = Math.max(0, (used[0] ?? 0) - 5), last = Math.min(counts.length, (used.at(-1) ?? 0) + 8);
      const [a, b] = [Math.log10(edges[first]), Math.log10(edges[last])], most = Math.log10(Math.max(...counts, 1) * 1.4);
      const x = (v) => LEFT + ((Math.log10(v) - a) / (b - a)) * (width - LEFT - RIGHT);
      const y = (n) => height - BOTTOM - ((n > 0 ? Math.log10(n) + 0.2 : 0) / (most + 0.2)) * (height - TOP - BOTTOM);
      this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
      this.svg.replaceChildren();
      for (const v of SCALES.log.ticks(edges[first], edges[last])) this.svg.append(label(x(v), height - 7, number(v)));
      for (let n = 1; Math.log10(n) <= most; n *= 10) {
        this.svg.append(label(LEFT - 5, y(n) + 4, number(n), "end"), element("path", { class: "grid", d: `M${LEFT} ${y(n)}H${width - RIGHT}` }));
      }
      const between = (k) => (k === 0 ? `up to ${number(edges[1])}` : k === counts.length - 1 ? `${number(edges[k])} and more` : `${number(edges[k])} to ${number(edges[k + 1])}`);
      for (let k = first; k < last; k++) {
        if (!counts[k]) continue;
        const bar = element("rect", { class: `bar ${colour}`, x: x(edges[k]), y: y(counts[k]), width: x(edges[k + 1]) - x(edges[k]) - 0.5, height: height - BOTTOM - y(counts[k]) });
        bar.onpointerenter = () => (this.readout.textContent = `${between(k)}: ${counts[k]}`);
        this.svg.append(bar);
      }
    }

    point() {}
  }

  // --- the map -------------------------------------------------------------------------------------------------------------

  class MapChart {
    constructor(figure, chart) {
      Object.assign(this, { figure, chart, height: 560 });
      const names = [...chart.paths.map((p) => [p.name, p.colour]), ...chart.marks.map((m) => [m.name, m.colour])];
      if (chart.ellipses.length) names.push(["95 % ellipses", "sky"]);
      if (chart.places.length) names.push(["landmarks of the map", "grey"]);
      if (chart.places.some((place) => place.used)) names.push(["landmarks used", "green"]);
      this.hidden = legend(figure, names, () => this.draw());
      this.readout = html("div", "readout");
      this.svg = element("svg", { class: "map", role: "img", "aria-label": chart.title });
      const tools = html("div", "tools");
      for (const [words, act] of [["+", () => this.zoom(0.6)], ["−", () => this.zoom(1 / 0.6)], ["whole flight", () => this.reset()]]) {
        const key = html("button", "", words);
        key.type = "button";
        key.onclick = act;
        tools.append(key, " ");
      }
      figure.append(this.readout, this.svg, tools);
      this.fit = true;
      this.listen();
    }

    reset() {
      this.fit = true;
      this.draw();
    }

    zoom(factor, x = this.centre[0], y = this.centre[1]) {
      this.fit = false;
      this.centre = [x + (this.centre[0] - x) * factor, y + (this.centre[1] - y) * factor];
      this.metres *= factor; // per pixel
      this.draw();
    }

    place(event) {
      const box = this.svg.getBoundingClientRect(), scale = this.width / box.width;
      const [px, py] = [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
      return [this.centre[0] + (px - this.width / 2) * this.metres, this.centre[1] - (py - this.height / 2) * this.metres];
    }

    listen() {
      let held = null;
      this.svg.onpointerdown = (event) => {
        held = this.place(event);
        this.svg.setPointerCapture(event.pointerId);
      };
      this.svg.onpointermove = (event) => {
        const [x, y] = this.place(event);
        if (held) {
          this.fit = false;
          this.centre = [this.centre[0] + held[0] - x, this.centre[1] + held[1] - y];
          this.draw();
        } else this.tell(x, y);
      };
      this.svg.onpointerup = () => (held = null);
      this.svg.onpointerleave = () => point(null);
      this.svg.addEventListener("wheel", (event) => {
        if (!event.ctrlKey) return; // a wheel alone scrolls the page
        event.preventDefault();
        this.zoom(event.deltaY > 0 ? 1.2 : 1 / 1.2, ...this.place(event));
      }, { passive: false });
    }

    tell(x, y) {
      const reach = 12 * this.metres, words = [`east ${number(x)} m, north ${number(y)} m`];
      let best = null;
      for (const path of this.chart.paths)
        path.x.forEach((px, k) => {
          const away = Math.hypot(px - x, path.y[k] - y);
          if (px !== null && path.name !== "truth" && away < (best?.away ?? reach)) best = { away, t: path.t[k], name: path.name };
        });
      for (const marks of this.chart.marks)
        marks.x.forEach((px, k) => Math.hypot(px - x, marks.y[k] - y) < 0.6 * reach && words.length < 5 && words.push(`${marks.name}: ${marks.text[k]}`));
      for (const spot of this.chart.places) if (inside(spot, x, y)) words.push(`landmark ${spot.name}${spot.used ? ", used" : ""}`);
      if (best) words.push(`${number(best.t, 6)} s: ${best.name}`);
      point(best ? best.t : null);
      this.readout.textContent = words.join("  ·  ");
    }

    draw() {
      this.width = Math.max(280, this.figure.clientWidth);
      if (this.fit) {
        const [west, south, east, north] = this.chart.box;
        this.centre = [(west + east) / 2, (south + north) / 2];
        this.metres = Math.max((east - west) / (this.width - 60), (north - south) / (this.height - 60));
      }
      const x = (v) => this.width / 2 + (v - this.centre[0]) / this.metres, y = (v) => this.height / 2 - (v - this.centre[1]) / this.metres;
      Object.assign(this, { x, y });
      const spot = (xs, ys) => xs.map((v, k) => `${x(v).toFixed(1)} ${y(ys[k]).toFixed(1)}`);
      this.svg.setAttribute("viewBox", `0 0 ${this.width} ${this.height}`);
      this.svg.replaceChildren();
      for (const v of niceSteps(this.centre[0] - (this.width / 2) * this.metres, this.centre[0] + (this.width / 2) * this.metres, this.width / 110))
        this.svg.append(element("path", { class: "grid", d: `M${x(v)} 0V${this.height}` }), label(x(v), this.height - 5, number(v, 6)));
      for (const v of niceSteps(this.centre[1] - (this.height / 2) * this.metres, this.centre[1] + (this.height / 2) * this.metres, this.height / 90))
        this.svg.append(element("path", { class: "grid", d: `M0 ${y(v)}H${this.width}` }), label(4, y(v) - 3, number(v, 6), "start"));
      for (const place of this.chart.places)
        if (!this.hidden.has(place.used ? "landmarks used" : "landmarks of the map"))
          this.svg.append(element("path", { class: place.used ? "place used" : "place", d: `M${spot(place.x, place.y).join("L")}Z` }));
      if (!this.hidden.has("95 % ellipses"))
        for (const e of this.chart.ellipses)
          this.svg.append(element("ellipse", { class: "ellipse", rx: e.a / this.metres, ry: e.b / this.metres, transform: `translate(${x(e.x)} ${y(e.y)}) rotate(${-e.turn_deg})` }));
      for (const path of this.chart.paths)
        if (!this.hidden.has(path.name) && path.x.length > 1) this.svg.append(element("path", { class: `line ${path.colour}`, d: `M${spot(path.x, path.y).join("L")}` }));
      for (const marks of this.chart.marks) if (!this.hidden.has(marks.name)) this.svg.append(this.marks(marks));
      this.svg.append(label(this.width - 8, 16, "north ↑   metres", "end"));
      this.point(view.cursor);
    }

    marks(marks) {
      const d = marks.x.map((v, k) => {
        const px = this.x(v).toFixed(1), py = this.y(marks.y[k]).toFixed(1), r = marks.shape === "ring" ? 6 : 2.5;
        return marks.shape === "cross" ? `M${px - 4} ${py - 4}l8 8m0 -8l-8 8` : `M${px - r} ${py}a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0`;
      });
      return element("path", { class: `${marks.shape === "dot" ? "point" : "mark"} ${marks.colour}`, d: d.join("") });
    }

    point(t) {
      this.svg.querySelector(".here")?.remove();
      if (t === null) return;
      let best = null;
      for (const path of this.chart.paths)
        if (path.name !== "truth") path.t.forEach((u, k) => Math.abs(u - t) < (best?.away ?? 2) && (best = { away: Math.abs(u - t), x: path.x[k], y: path.y[k] }));
      if (best) this.svg.append(element("circle", { class: "here", cx: this.x(best.x), cy: this.y(best.y), r: 6 }));
    }
  }

  const inside = (place, x, y) => {
    let odd = false;
    for (let i = 0, j = place.x.length - 1; i < place.x.length; j = i++)
      if (place.y[i] > y !== place.y[j] > y && x < ((place.x[j] - place.x[i]) * (y - place.y[i])) / (place.y[j] - place.y[i]) + place.x[i]) odd = !odd;
    return odd;
  };

  // --- all together --------------------------------------------------------------------------------------------------------

  const point = (t) => {
    view.cursor = t;
    for (const chart of all) chart.point(t);
  };
  const show = (from, until) => {
    Object.assign(view, { begin: from, end: until });
    for (const chart of all) if (chart instanceof OverTime) chart.draw();
  };

  const KINDS = { time: TimeChart, strip: StripChart, bars: BarChart, map: MapChart };
  for (const figure of document.querySelectorAll("figure[data-chart]")) {
    const chart = charts[figure.dataset.chart];
    all.push(new KINDS[chart.type](figure, chart));
  }
  for (const key of document.querySelectorAll("[data-whole]")) key.onclick = () => show(begin, end);
  const drawAll = () => all.forEach((chart) => chart.draw());
  let waiting = 0;
  window.addEventListener("resize", () => {
    clearTimeout(waiting);
    waiting = setTimeout(drawAll, 100);
  });
  drawAll();
})();
