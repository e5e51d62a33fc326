"use strict";
// One episode on the page: its map, its layers, its images, and the sentence on the current decision.

const RUN_CLASSES = ["first", "second"]; // CSS classes with the colours of the runs
const find = (id) => document.getElementById(id);
const ticked = (id) => find(id).checked;

// Return a CSS variable with a colour #rrggbb as three numbers 0..1. Legend and map use the same variables.
function tint(name) {
  const text = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  return [1, 3, 5].map((at) => parseInt(text.slice(at, at + 2), 16) / 255);
}

function element(kind, options = {}, ...inside) {
  const made = document.createElement(kind);
  for (const [name, value] of Object.entries(options)) if (name in made) made[name] = value; else made.setAttribute(name, value);
  made.append(...inside);
  return made;
}

const short = (value) => Number(value.toPrecision(3)).toLocaleString("en", { maximumSignificantDigits: 3 });
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

class Run {
  constructor(film, number) {
    this.film = film;
    this.arrays = film.arrays;
    this.measure();
    this.canvas = element("canvas", { ariaLabel: `the map of ${film.name}` });
    this.true = element("img", { alt: "last keyframe of the camera" });
    this.rendered = element("img", { alt: "map rendered at the pose of the keyframe" });
    this.why = element("details", { className: "why", ariaLabel: "why this view was chosen", hidden: true });
    this.facts = element("p");
    this.pictures = element("div", { className: "images" },
      element("figure", {}, this.true, element("figcaption", {}, "camera")),
      element("figure", {}, this.rendered, element("figcaption", {}, "map")));
    this.stage = element("div", { className: "stage" }, this.canvas, element("h2", { className: RUN_CLASSES[number], hidden: !film.name }, film.name),
      this.pictures, element("span", { className: "hint" }, "drag: turn · shift or right button: move · wheel: zoom"));
    this.element = element("section", { className: "run" }, this.stage, element("div", { className: `note of-${RUN_CLASSES[number]}`, "data-name": film.name }, this.why, this.facts));
    if (film.warning) this.facts.after(element("p", { className: "warning" }, film.warning));
    this.orbit = new Orbit(film.bounds, this.arrays.poses);
    this.images = new Map();
  }

  start() { this.scene = new SceneView(this.canvas, this.film); }
  close() { // release resources that the browser would keep until the page is closed
    for (const link of this.images.values()) URL.revokeObjectURL(link);
    const lose = this.scene.gl.getExtension("WEBGL_lose_context");
    if (lose) lose.loseContext();
  }

  measure() {
    this.last = this.arrays.poses.length / 9 - 1;
    this.end = this.arrays.frames[this.arrays.frames.length - 1];
  }

  extend(film) { // add new data: the current map, and further moments and poses
    const mine = this.arrays, news = film.arrays, joined = { ...news };
    for (const [name, array] of Object.entries(mine)) {
      if (["means", "scales", "rotations", "colours", "opacities", "added", "removed"].includes(name)) continue;
      const starts = name.endsWith("_starts"), more = starts ? news[name].subarray(1) : news[name];
      joined[name] = new array.constructor(array.length + more.length);
      joined[name].set(array);
      joined[name].set(starts ? more.map((place) => place + array[array.length - 1]) : more, array.length);
    }
    const curve = this.film.curve.concat(film.curve), steps = this.film.steps.concat(film.steps);
    Object.assign(this.film, film, { curve, steps, arrays: joined });
    this.arrays = joined;
    this.measure();
    this.scene.load();
  }

  moment(frame) { // index of the current decision: the last one at or before this frame
    const frames = this.arrays.frames;
    let found = 0;
    while (found + 1 < frames.length && frames[found + 1] <= frame) found++;
    return found;
  }

  walked(frame) { // index of the pose at a frame; frames spent in place have no pose of their own
    const now = this.moment(frame), { frames, walked } = this.arrays;
    const most = now + 1 < walked.length ? walked[now + 1] - 1 : this.last;
    return Math.max(Math.min(walked[now] - 1 + Math.round(frame) - frames[now], most, this.last), 0);
  }

  pose(frame) {
    const at = 9 * this.walked(frame), p = this.arrays.poses;
    const position = [p[at], p[at + 1], p[at + 2]], right = [p[at + 3], p[at + 4], p[at + 5]], forward = [p[at + 6], p[at + 7], p[at + 8]];
    return { position, right, up: cross(right, forward), forward };
  }

  candidate(k) { // pose and costs of a candidate; k counts over all decisions
    const [x, y, z, u, v, w, metres, frames] = this.arrays.candidates.subarray(8 * k, 8 * k + 8);
    const flat = Math.hypot(u, v), right = flat > 1e-6 ? [v / flat, -u / flat, 0] : [1, 0, 0], forward = [u, v, w];
    return { position: [x, y, z], right, up: cross(right, forward), forward, metres, frames };
  }

  camera(eye, frame) {
    return eye === "orbit" ? this.orbit.camera(this.canvas.clientWidth / Math.max(this.canvas.clientHeight, 1))
      : this.lens(this.pose(frame), this.canvas.clientWidth / Math.max(this.canvas.clientHeight, 1), `agent ${Math.round(frame)}`);
  }

  lens({ position, right, up, forward }, aspect, key) { // the agent's camera at a pose
    const focal = this.film.camera[1] / this.film.camera[5];
    return { view: viewMatrix(position, right, up, forward.map((v) => -v)), projection: perspective(focal, aspect, 0.05, 400), focal, key };
  }

  span(now) { // candidates of a decision: the first, the end, the chosen one and the runner-up; -1 if there is none
    const { candidate_starts: starts, rows } = this.arrays, first = starts[now], second = (this.reason(now) || {}).runner_up;
    return { first, end: starts[now + 1], chosen: rows[now] < 0 ? -1 : first + rows[now], second: second >= 0 ? first + second : -1 };
  }

  drawn(now, shown) { // which candidates of a decision are shown; none after the last decision of a finished run
    const { first, end, chosen } = this.span(now), found = [];
    if (chosen < 0 && !this.film.chooses) return found;
    for (let k = first; k < end; k++)
      if ((k === chosen ? shown.chosen : shown.candidates) && this.arrays.candidates[8 * k + 2] <= shown.cut) found.push(k);
    return found;
  }

  shades(now) { // scores of a decision as 0..1, from the lower of 0 and the lowest score to the highest
    const { first, end } = this.span(now), scores = this.arrays.scores.subarray(first, end);
    const low = Math.min(0, ...scores), high = Math.max(...scores);
    return Array.from(scores, (score) => (score - low) / Math.max(high - low, 1e-12) || 0);
  }

  overlay(frame, shown) { // thin lines, thick lines, points and faces: flat lists of position and colour
    const into = { lines: [], strokes: [], points: [], faces: [] }, a = this.arrays, now = this.moment(frame), cut = shown.cut;
    const line = (kind, from, to, colour, alpha = 1) => into[kind].push(...from, ...colour, alpha, ...to, ...colour, alpha);
    const frustum = (kind, pose, reach, colour, fill) => {
      const [fx, fy, , , width, height] = this.film.camera, { position, right, forward, up } = pose;
      const c = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([x, y]) => position.map((v, i) =>
        v + reach * (forward[i] + x * 0.5 * width / fx * right[i] + y * 0.5 * height / fy * up[i])));
      c.forEach((corner, i) => { line(kind, position, corner, colour); line(kind, corner, c[(i + 1) % 4], colour); });
      for (const i of [0, 1, 2, 0, 2, 3]) into.faces.push(...c[i], ...colour, fill);
    };
    for (let k = a.plane_starts[now]; shown.planes && k < a.plane_starts[now + 1]; k++) {
      const colour = tint(a.structural[k] ? "structural" : "object"), c = [];
      for (let i = 0; i < 4; i++) c.push(Array.from(a.planes.subarray(12 * k + 3 * i, 12 * k + 3 * i + 3)));
      if (c.every((corner) => corner[2] > cut)) continue;
      const low = c.map((corner) => [corner[0], corner[1], Math.min(corner[2], cut)]);
      for (let i = 0; i < 4; i++) line("lines", low[i], low[(i + 1) % 4], colour, 0.9);
      for (const i of [0, 1, 2, 0, 2, 3]) into.faces.push(...low[i], ...colour, 0.15);
    }
    for (let e = a.tree_starts[now], colour = tint("tree"); shown.tree && e < a.tree_starts[now + 1]; e++) {
      const ends = [0, 1].map((i) => { const k = a.plane_starts[now] + a.tree[2 * e + i]; return Array.from(a.centroids.subarray(3 * k, 3 * k + 3)); });
      if (ends.some((end) => end[2] > cut)) continue;
      line("lines", ends[0], ends[1], colour, 0.9);
      for (const end of ends) into.points.push(...end, ...colour, 0.9);
    }
    const { first, chosen, second } = this.span(now), shades = this.shades(now), low = tint("low"), high = tint("high");
    for (const k of this.drawn(now, shown)) {
      const pose = this.candidate(k), pointed = k - first === shown.pointed;
      const colour = k === chosen ? tint("chosen") : k === second ? tint("runner-up") : low.map((v, i) => v + shades[k - first] * (high[i] - v));
      if (k === chosen || k === second || pointed) frustum(k === second && !pointed ? "lines" : "strokes", pose, pointed ? 0.9 : 0.5, colour, 0.2);
      else line("lines", pose.position, this.tip(pose), colour);
      if (this.film.chooses) into.points.push(...this.tip(pose), ...colour, 1);
    }
    if (shown.path && shown.eye === "orbit") {
      const until = this.walked(frame), colour = tint("path"), pose = this.pose(frame);
      for (let i = 1; i <= until; i++)
        line("strokes", a.poses.subarray(9 * i - 9, 9 * i - 6), a.poses.subarray(9 * i, 9 * i + 3), colour, 0.5 + 0.5 * Math.exp((i - until) / 120));
      frustum("strokes", pose, 0.55, colour, 0.25);
    }
    return into;
  }

  tip({ position, forward }) { return position.map((v, i) => v + 0.2 * forward[i]); }

  under(x, y, camera, frame, shown) { // row of the shown candidate nearest to a canvas position, or -1
    const now = this.moment(frame), m = camera.view, q = camera.projection;
    let best = -1, least = 18; // CSS pixels
    for (const k of this.drawn(now, shown)) {
      const [u, v, w] = this.tip(this.candidate(k));
      const [ex, ey, ez] = [0, 1, 2].map((i) => m[i] * u + m[4 + i] * v + m[8 + i] * w + m[12 + i]);
      if (ez > -0.05) continue;
      const left = (0.5 + 0.5 * q[0] * ex / -ez) * this.canvas.clientWidth, top = (0.5 - 0.5 * q[5] * ey / -ez) * this.canvas.clientHeight;
      const away = Math.hypot(left - x, top - y);
      if (away < least) { least = away; best = k - this.span(now).first; }
    }
    return best;
  }

  describe(row, frame) { // what a candidate sees and costs, as elements
    const now = this.moment(frame), { first, end, chosen, second } = this.span(now), k = first + row, one = this.candidate(k);
    const scores = this.arrays.scores.subarray(first, end), better = scores.filter((score) => score > scores[row]).length;
    const kind = k === chosen ? "chosen view" : k === second ? "runner-up" : "candidate";
    const canvas = element("canvas", { width: 320, height: 180 });
    this.scene.preview(this.lens(one, 16 / 9), Math.round(frame), canvas, tint("background"));
    const lines = [`${kind}: the map seen from there`, `costs ${one.frames} frames, ${one.metres.toFixed(2)} m`];
    if (!Number.isNaN(scores[row])) lines.splice(1, 0, `${this.film.feature} ${short(scores[row])}, rank ${better + 1} of ${end - first}`);
    return [canvas, ...lines.map((text) => element("p", {}, text))];
  }

  image(number) {
    if (!this.images.has(number)) {
      const starts = this.arrays.image_starts, data = this.arrays.images.slice(starts[number], starts[number + 1]);
      this.images.set(number, URL.createObjectURL(new Blob([data], { type: "image/jpeg" })));
    }
    return this.images.get(number);
  }

  reason(now) { return (this.film.steps[now] || {}).why; } // undefined or null if the run stores none

  explain(now) { // show why the view of this decision was chosen
    const why = this.reason(now);
    this.why.hidden = !why;
    if (!why || this.explained === now) return;
    this.explained = now;
    const heads = ["", "chosen", "runner-up"].slice(0, why.table[0].length);
    const head = element("tr", {}, ...heads.map((text) => element("th", { className: text }, text)));
    const line = ([name, ...values]) => element("tr", {}, element("th", {}, name), ...values.map((value) => element("td", {}, value)));
    this.why.replaceChildren(element("summary", {}, why.reason), element("table", {}, head, ...why.table.map(line)));
  }

  update(frame) {
    const now = this.moment(frame), step = this.film.steps[now], before = this.film.steps[now - 1];
    for (const [place, number] of [[this.true, 2 * now], [this.rendered, 2 * now + 1]]) {
      const link = this.image(number);
      if (place.src !== link) place.src = link;
    }
    this.pictures.hidden = !ticked("show-images");
    this.explain(now);
    const live = this.film.episode, metres = live ? step.metres : before ? before.metres : 0;
    const facts = [live ? `decision ${now + 1}` : step ? `decision ${step.number} of ${this.film.decisions}` : "no decisions left",
      step && step.phase ? `phase ${step.phase}` : "", `path ${metres.toFixed(1)} m`, `${this.scene.countAt(Math.round(frame)).toLocaleString("en")} Gaussians`,
      `${this.arrays.plane_starts[now + 1] - this.arrays.plane_starts[now]} planes`];
    this.facts.textContent = facts.filter(Boolean).join(" · ");
  }
}
