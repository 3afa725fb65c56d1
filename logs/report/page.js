// Finds the places of the charts on the page, and draws.

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
