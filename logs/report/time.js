// Charts over time: signals with their bands, single events, strips of states. All show the same time.

const LEFT = 58, RIGHT = 10, TOP = 8, BOTTOM = 22, ROW = 30;

class OverTime {
  constructor(figure, chart) {
    Object.assign(this, { figure, chart, height: chart.height || ROW * Object.keys(chart.rows || {}).length + TOP + BOTTOM });
    figure.append(html("figcaption", "", chart.title + (chart.unit ? ` [${chart.unit}]` : "")));
    this.hidden = chart.parts ? legend(figure, chart.parts.map((p) => [p.name, p.colour, p.shape ?? (p.type === "line" ? "line" : "")]), () => this.draw()) : new Set();
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
      if (this.x(t) < this.width - RIGHT - 25) this.svg.append(label(this.x(t), this.height - 7, number(t, 6))); // the unit stands there
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
  constructor(figure, chart) {
    super(figure, chart);
    const row = html("div", "legend"), stays = Object.values(chart.rows).flat();
    for (const [name, colour] of new Map(stays.map((stay) => [stay.name, stay.colour]))) row.append(html("span", "", html("i", colour), name));
    figure.querySelector("figcaption").after(row);
  }

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
