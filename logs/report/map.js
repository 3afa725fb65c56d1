// Bars, and the map.

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
    const names = [...chart.paths.map((p) => [p.name, p.colour, p.dashed ? "dashed" : "line"]), ...chart.marks.map((m) => [m.name, m.colour, m.shape])];
    if (chart.ellipses.length) names.push(["95 % ellipses", "sky", "ellipse"]);
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
        if (px !== null && !path.dashed && away < (best?.away ?? reach)) best = { away, t: path.t[k], name: path.name };
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
      if (!this.hidden.has(path.name) && path.x.length > 1) this.svg.append(element("path", { class: `line ${path.colour}${path.dashed ? " dashed" : ""}`, d: `M${spot(path.x, path.y).join("L")}` }));
    for (const marks of this.chart.marks) if (!this.hidden.has(marks.name)) this.svg.append(this.marks(marks));
    this.svg.append(label(this.width - 8, 16, "north ↑   metres", "end"));
    this.point(view.cursor);
  }

  marks(marks) {
    const d = marks.x.map((v, k) => `M${this.x(v).toFixed(1)} ${this.y(marks.y[k]).toFixed(1)}${GLYPHS[marks.shape]}`);
    return element("path", { class: `${FILLED.has(marks.shape) ? "point" : "mark"} ${marks.colour}`, d: d.join("") });
  }

  point(t) {
    this.svg.querySelector(".here")?.remove();
    if (t === null) return;
    let best = null;
    for (const path of this.chart.paths)
      if (!path.dashed) path.t.forEach((u, k) => Math.abs(u - t) < (best?.away ?? 2) && (best = { away: Math.abs(u - t), x: path.x[k], y: path.y[k] }));
    if (best) this.svg.append(element("circle", { class: "here", cx: this.x(best.x), cy: this.y(best.y), r: 6 }));
  }
}

const inside = (place, x, y) => {
  let odd = false;
  for (let i = 0, j = place.x.length - 1; i < place.x.length; j = i++)
    if (place.y[i] > y !== place.y[j] > y && x < ((place.x[j] - place.x[i]) * (y - place.y[i])) / (place.y[j] - place.y[i]) + place.x[i]) odd = !odd;
  return odd;
};
