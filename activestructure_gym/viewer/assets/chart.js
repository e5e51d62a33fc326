"use strict";
// A curve per run over the frames, with ticks, and the run's name and last value at the end of its curve.

const WIDE = 400, TOP = 8, BOTTOM = 96, LEFT = 30; // of the drawing and its axes, in units of the SVG's view box
const LETTER = 5.9, LABEL = 12; // width of a letter and height of a label

// Names of the measures, as in the tables of a report; the first one that a run has leads the page.
const MEASURES = [
  { key: "observed", name: "observed surface", unit: "%", says: "of the surface observed" },
  { key: "known_m3", name: "known space", unit: "m³", says: "of space known" },
  { key: "known", name: "known space", unit: "%", says: "of the space known" },
  { key: "completion_ratio", name: "completion ratio (C.R.)", unit: "%" },
  { key: "psnr", name: "PSNR", unit: "dB" },
  { key: "fidelity", name: "keyframe PSNR", unit: "dB" },
];

const valueAt = (line, frame) => line.reduce((value, [x, y]) => x <= frame ? y : value, null);
const pointsOf = (run, key) => run.film.curve.filter((point) => typeof point[key] === "number").map((point) => [point.frames, point[key]]);

function ticks(low, high) { // two to five round numbers
  const raw = (high - low) / 3, power = 10 ** Math.floor(Math.log10(Math.max(raw, 1e-9)));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((one) => one >= raw), found = [];
  for (let value = Math.ceil(low / step) * step; value <= high + 1e-9; value += step) found.push(Number(value.toFixed(6)));
  return found;
}

class Chart {
  constructor(measure, runs, end) {
    this.measure = measure;
    this.end = Math.max(end, 2);
    this.points = runs.map((run) => pointsOf(run, measure.key));
    const values = this.points.flat().map(([, value]) => value);
    if (!values.length) return;
    this.low = measure.unit === "dB" ? Math.floor(Math.min(...values)) : 0;
    this.high = measure.unit === "%" ? 100 : Math.ceil(Math.max(...values, this.low + 1));
    const labels = this.points.map((line, i) => ({ i, y: line.length ? this.y(line[line.length - 1][1]) : BOTTOM, text: line.length
      ? `${runs.length > 1 ? `${runs[i].film.name.slice(0, 16)} ` : ""}${line[line.length - 1][1].toFixed(1)}` : "" }));
    this.right = WIDE - 8 - LETTER * Math.max(...labels.map(({ text }) => text.length));
    const order = [...labels].sort((a, b) => a.y - b.y); // labels of close curves make room for each other
    const missing = order.length > 1 ? Math.max(LABEL - order[1].y + order[0].y, 0) / 2 : 0;
    if (missing) { order[0].y -= missing; order[1].y += missing; }
    const draw = (kind, options, inside = "") => `<${kind} ${Object.entries(options).map(([name, value]) => `${name}="${value}"`).join(" ")}>${inside}</${kind}>`;
    const parts = ticks(this.low, this.high).flatMap((value) => [draw("line", { class: "grid", x1: LEFT, x2: this.right, y1: this.y(value), y2: this.y(value) }),
      draw("text", { x: LEFT - 5, y: this.y(value) + 4, "text-anchor": "end" }, value)]);
    ticks(1, this.end).filter(Number.isInteger).forEach((value, i, all) => parts.push(draw("text", { x: this.x(value), y: BOTTOM + 14, "text-anchor": "middle" },
      i + 1 < all.length ? value : `${value} frames`)));
    parts.push(draw("line", { class: "cursor", y1: TOP, y2: BOTTOM }));
    this.points.forEach((line, i) => parts.push(draw("polyline", { class: RUN_CLASSES[i], points: line.map(([x, y]) => `${this.x(x)},${this.y(y)}`).join(" ") })));
    this.svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    this.svg.setAttribute("viewBox", `0 0 ${WIDE} ${BOTTOM + 18}`);
    this.svg.innerHTML = parts.join("");
    for (const { i, y, text } of labels) { // names of runs are text and never markup
      const label = document.createElementNS("http://www.w3.org/2000/svg", "text");
      for (const [name, value] of [["class", RUN_CLASSES[i]], ["x", this.right + 5], ["y", y + 4]]) label.setAttribute(name, value);
      label.textContent = text;
      this.svg.append(label);
    }
    this.cursor = this.svg.querySelector(".cursor");
    this.title = element("figcaption");
    this.element = element("figure", { className: "chart" }, this.title, this.svg);
  }

  x(frame) { return LEFT + (this.right - LEFT) * (frame - 1) / (this.end - 1); }
  y(value) { return BOTTOM - (BOTTOM - TOP) * (value - this.low) / Math.max(this.high - this.low, 1e-9); }

  update(frame) {
    for (const end of ["x1", "x2"]) this.cursor.setAttribute(end, this.x(frame));
    const { name, unit } = this.measure, values = this.points.map((line) => valueAt(line, frame));
    this.title.replaceChildren(name, ...values.map((value, i) =>
      element("strong", { className: RUN_CLASSES[i] }, value === null ? " –" : ` ${value.toFixed(1)} ${unit}`)));
  }
}

function leader(runs, frame, budget) { // one sentence: which run has observed more at this frame
  const measure = MEASURES.find(({ key }) => runs.every((run) => pointsOf(run, key).length));
  if (!measure) return "";
  const when = `after ${Math.round(frame)} of ${budget} frames`, number = (value) => `${value.toFixed(1)}\u00a0${measure.unit}`;
  const found = runs.map((run) => ({ name: run.film.name, value: valueAt(pointsOf(run, measure.key), frame) || 0 }));
  if (found.length === 1) return `${found[0].name && `${found[0].name}: `}${number(found[0].value)} ${measure.says} ${when}.`;
  const [best, other] = found.sort((a, b) => b.value - a.value);
  if (best.value.toFixed(1) === other.value.toFixed(1)) return `No run leads ${when}: both have ${number(best.value)} ${measure.says}.`;
  return `${best.name} leads ${when}: ${number(best.value)} ${measure.says}, ${other.name} ${number(other.value)}.`;
}
