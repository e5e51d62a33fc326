"use strict";
// Play one or two episodes on one clock, which counts frames used. A live episode grows while it is shown.

const COLOURS = { path: [0.84, 0.37, 0.0], structural: [0.0, 0.45, 0.7], object: [0.8, 0.47, 0.65], tree: [0.0, 0.62, 0.45],
  unknown: [0.5, 0.5, 0.5], runnerUp: [0.34, 0.71, 0.91] };
const RUN_CLASSES = ["first", "second"]; // classes of the curves' colours
const MANY = 20000; // maps with more Gaussians are drawn coarsely while the view is dragged
const find = (id) => document.getElementById(id);

function viridis(share) {
  const stops = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
  const at = Math.min(Math.max(share, 0), 1) * 4, low = Math.min(Math.floor(at), 3), part = at - low;
  return stops[low].map((value, i) => (value + part * (stops[low + 1][i] - value)) / 255);
}

function element(kind, options = {}, ...inside) {
  const made = document.createElement(kind);
  for (const [name, value] of Object.entries(options)) if (name in made) made[name] = value; else made.setAttribute(name, value);
  made.append(...inside);
  return made;
}

class Run {
  constructor(film, number) {
    this.film = film;
    this.arrays = film.arrays;
    this.measure();
    this.canvas = element("canvas", { ariaLabel: `the map of ${film.title}` });
    this.true = element("img", { alt: "camera image" });
    this.rendered = element("img", { alt: "map rendered at the same pose" });
    this.facts = element("dl");
    this.why = element("details", { className: "why", ariaLabel: "why this view was chosen", hidden: true });
    const side = element("div", { className: "side" },
      element("figure", {}, this.true, element("figcaption", {}, "last keyframe of the camera")),
      element("figure", {}, this.rendered, element("figcaption", {}, "map rendered at the same pose, at that time")),
      this.facts);
    const stage = element("div", { className: "stage" }, this.canvas, element("p", { className: `name ${RUN_CLASSES[number]}` }, film.title),
      element("span", { className: "hint" }, "drag: turn · shift or right button: move · wheel: zoom"));
    this.element = element("section", { className: "run" }, stage, this.why, side);
    if (film.warning) side.prepend(element("p", { className: "warning" }, film.warning));
    this.orbit = new Orbit(film.bounds);
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
    const up = [right[1] * forward[2] - right[2] * forward[1], right[2] * forward[0] - right[0] * forward[2], right[0] * forward[1] - right[1] * forward[0]];
    return { position, right, up, forward };
  }

  camera(eye, frame) {
    const aspect = this.canvas.clientWidth / Math.max(this.canvas.clientHeight, 1);
    if (eye === "orbit") return this.orbit.camera(aspect);
    const { position, right, up, forward } = this.pose(frame);
    const focal = this.film.camera[1] / this.film.camera[5];
    return { view: viewMatrix(position, right, up, forward.map((v) => -v)), projection: perspective(focal, aspect, 0.05, 400), focal, key: `agent ${Math.round(frame)}` };
  }

  overlay(frame, shown) {
    const lines = [], points = [], faces = [], a = this.arrays, now = this.moment(frame);
    const line = (from, to, tint, alpha = 1) => lines.push(...from, ...tint, alpha, ...to, ...tint, alpha);
    const cut = shown.cut;
    if (shown.planes) {
      for (let k = a.plane_starts[now]; k < a.plane_starts[now + 1]; k++) {
        const tint = a.structural[k] ? COLOURS.structural : COLOURS.object, c = [];
        for (let i = 0; i < 4; i++) c.push(Array.from(a.planes.subarray(12 * k + 3 * i, 12 * k + 3 * i + 3)));
        if (c.every((corner) => corner[2] > cut)) continue;
        const low = c.map((corner) => [corner[0], corner[1], Math.min(corner[2], cut)]);
        for (let i = 0; i < 4; i++) line(low[i], low[(i + 1) % 4], tint, 0.9);
        for (const i of [0, 1, 2, 0, 2, 3]) faces.push(...low[i], ...tint, 0.1);
      }
      const first = a.plane_starts[now];
      for (let e = a.tree_starts[now]; e < a.tree_starts[now + 1]; e++) {
        const ends = [0, 1].map((i) => { const k = first + a.tree[2 * e + i]; return Array.from(a.centroids.subarray(3 * k, 3 * k + 3)); });
        if (ends.some((end) => end[2] > cut)) continue;
        line(ends[0], ends[1], COLOURS.tree, 0.9);
        for (const end of ends) points.push(...end, ...COLOURS.tree, 0.9);
      }
    }
    if (shown.candidates && (a.rows[now] >= 0 || this.film.chooses)) { // none after the last decision
      const first = a.candidate_starts[now], chosen = first + a.rows[now], second = shown.why && this.reason(now) ? first + this.reason(now).runner_up : -1;
      for (let k = first; k < a.candidate_starts[now + 1]; k++) {
        const p = a.candidates.subarray(6 * k, 6 * k + 6), score = a.scores[k];
        if (p[2] > cut) continue;
        const tint = k === chosen && a.rows[now] >= 0 ? COLOURS.path : k === second ? COLOURS.runnerUp : score === 255 ? COLOURS.unknown : viridis(score / 254);
        const reach = k === chosen || k === second || k - first === shown.pointed ? 0.45 : 0.2, alpha = k === chosen ? 1 : 0.85;
        const tip = [p[0] + reach * p[3], p[1] + reach * p[4], p[2] + reach * p[5]];
        line([p[0], p[1], p[2]], tip, tint, alpha);
        if (k === chosen || k === second) points.push(p[0], p[1], p[2], ...tint, 1);
        if (this.film.chooses && now === a.frames.length - 1) points.push(...tip, ...(k - first === shown.pointed ? COLOURS.path : tint), 1);
      }
    }
    if (shown.path && shown.eye === "orbit") {
      const until = this.walked(frame);
      for (let i = 1; i <= until; i++) {
        const fade = 0.35 + 0.65 * Math.exp((i - until) / 120);
        line(a.poses.subarray(9 * i - 9, 9 * i - 6), a.poses.subarray(9 * i, 9 * i + 3), COLOURS.path, fade);
      }
      const { position, right, up, forward } = this.pose(frame), [fx, fy, , , width, height] = this.film.camera, reach = 0.55;
      const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([x, y]) => position.map((v, i) =>
        v + reach * (forward[i] + x * 0.5 * width / fx * right[i] + y * 0.5 * height / fy * up[i])));
      corners.forEach((corner, i) => { line(position, corner, COLOURS.path); line(corner, corners[(i + 1) % 4], COLOURS.path); });
      for (const i of [0, 1, 2, 0, 2, 3]) faces.push(...corners[i], ...COLOURS.path, 0.25);
      points.push(...position, ...COLOURS.path, 1);
    }
    return { lines, points, faces };
  }

  under(x, y, camera, cut) { // row of the current candidate drawn nearest to a canvas position, or -1
    const a = this.arrays, now = a.frames.length - 1, first = a.candidate_starts[now], m = camera.view, q = camera.projection;
    let best = -1, least = 18; // CSS pixels
    for (let k = first; k < a.candidate_starts[now + 1]; k++) {
      const p = a.candidates.subarray(6 * k, 6 * k + 6);
      if (p[2] > cut) continue;
      const [u, v, w] = [0, 1, 2].map((i) => p[i] + 0.2 * p[i + 3]);
      const [ex, ey, ez] = [0, 1, 2].map((i) => m[i] * u + m[4 + i] * v + m[8 + i] * w + m[12 + i]);
      if (ez > -0.05) continue;
      const left = (0.5 + 0.5 * q[0] * ex / -ez) * this.canvas.clientWidth, top = (0.5 - 0.5 * q[5] * ey / -ez) * this.canvas.clientHeight;
      const away = Math.hypot(left - x, top - y);
      if (away < least) { least = away; best = k - first; }
    }
    return best;
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
    this.why.hidden = !why || !find("show-why").checked;
    if (this.why.hidden || this.explained === now) return;
    this.explained = now;
    const heads = ["", "chosen", "runner-up"].slice(0, why.table[0].length);
    const line = (kind, [name, ...values]) => element("tr", {}, element("th", {}, name), ...values.map((value) => element(kind, {}, value)));
    this.why.replaceChildren(element("summary", {}, why.reason), element("table", {}, line("th", heads), ...why.table.map((row) => line("td", row))));
  }

  update(frame) {
    const now = this.moment(frame), step = this.film.steps[now], before = this.film.steps[now - 1];
    for (const [place, number] of [[this.true, 2 * now], [this.rendered, 2 * now + 1]]) {
      const link = this.image(number);
      if (place.src !== link) place.src = link;
    }
    const rows = [["frame", `${Math.min(Math.round(frame), this.end)} of ${this.film.budget}`],
      ["decision", this.film.episode ? now + 1 : step ? `${step.number} of ${this.film.decisions}` : "ended"]];
    if (step && step.phase) rows.push(["phase", step.phase]);
    rows.push(["Gaussians", this.scene.countAt(Math.round(frame)).toLocaleString("en")], ["planes", this.arrays.plane_starts[now + 1] - this.arrays.plane_starts[now]],
      ["candidates", this.arrays.rows[now] < 0 && !this.film.chooses ? "–" : this.arrays.candidate_starts[now + 1] - this.arrays.candidate_starts[now]], ["path length", `${this.film.episode ? step.metres : before ? before.metres : 0} m`]);
    this.explain(now);
    this.facts.replaceChildren(...rows.flatMap(([name, value]) => [element("dt", {}, name), element("dd", {}, String(value))]));
  }
}

class Chart {
  constructor(name, unit, key, runs, end) {
    Object.assign(this, { name, unit, key, runs, end });
    this.svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    this.svg.setAttribute("viewBox", "0 0 300 84");
    this.svg.setAttribute("preserveAspectRatio", "none");
    const points = runs.map((run) => run.film.curve.filter((point) => typeof point[key] === "number").map((point) => [point.frames, point[key]]));
    const values = points.flat().map(([, value]) => value);
    this.points = points;
    if (!values.length) return;
    this.low = key === "psnr" || key === "fidelity" ? Math.floor(Math.min(...values)) : 0;
    this.high = key === "psnr" || key === "fidelity" ? Math.ceil(Math.max(...values)) : 100;
    const tints = ["var(--first)", "var(--second)"];
    const parts = points.map((line, i) => `<polyline fill="none" stroke="${tints[i]}" stroke-width="2" vector-effect="non-scaling-stroke" points="${line.map(([x, y]) => `${this.x(x)},${this.y(y)}`).join(" ")}"/>`);
    this.svg.innerHTML = `<line x1="0" x2="300" y1="76" y2="76" stroke="var(--line)" vector-effect="non-scaling-stroke"/>${parts.join("")}<line class="cursor" y1="4" y2="76" stroke="var(--soft)" vector-effect="non-scaling-stroke"/>`;
    this.cursor = this.svg.querySelector(".cursor");
    this.title = element("figcaption");
    this.element = element("figure", {}, this.title, this.svg);
  }
  x(frame) { return 300 * frame / Math.max(this.end, 1); }
  y(value) { return 76 - 70 * (value - this.low) / Math.max(this.high - this.low, 1e-9); }
  at(line, frame) {
    let value = null;
    for (const [x, y] of line) if (x <= frame) value = y;
    return value;
  }
  update(frame) {
    if (!this.element) return;
    this.cursor.setAttribute("x1", this.x(frame));
    this.cursor.setAttribute("x2", this.x(frame));
    const said = this.points.map((line) => this.at(line, frame)).map((value) => value === null ? "–" : `${value.toFixed(1)} ${this.unit}`);
    this.title.replaceChildren(`${this.name}, axis ${this.low} to ${this.high} ${this.unit}: `, ...said.flatMap((text, i) => [i ? " against " : "", element("strong", { className: RUN_CLASSES[i] }, text)]));
  }
}

class Player {
  constructor(runs) {
    this.clock = 1;
    this.playing = false;
    this.dirty = true;
    this.moved = -1e9; // time at which the view was last changed
    this.drawn = 0; // number of images drawn
    this.pointed = -1; // the candidate under the pointer
    this.open(runs);
    find("clock").addEventListener("input", (event) => this.scrub(Number(event.target.value)));
    find("play").addEventListener("click", () => this.toggle());
    find("back").addEventListener("click", () => this.step(-1));
    find("on").addEventListener("click", () => this.step(1));
    find("home").addEventListener("click", () => { for (const run of this.runs) run.orbit.reset(); this.dirty = true; });
    for (const name of ["show-map", "show-planes", "show-candidates", "show-path", "show-why", "cut", "eye"].filter(find))
      find(name).addEventListener("input", () => { this.dirty = true; });
    window.addEventListener("resize", () => { this.dirty = true; });
    document.addEventListener("keydown", (event) => {
      if (["INPUT", "SELECT", "BUTTON"].includes(event.target.tagName)) return;
      if (event.key === " ") { event.preventDefault(); this.toggle(); }
      if (event.key === "ArrowRight") this.step(1);
      if (event.key === "ArrowLeft") this.step(-1);
    });
    const tick = (time) => { this.tick(time); requestAnimationFrame(tick); };
    requestAnimationFrame(tick);
  }

  open(runs) {
    this.runs = runs;
    this.end = Math.max(...runs.map((run) => run.end));
    this.usual = this.end / 20; // frames per second for a playback of 20 s
    const low = Math.min(...runs.map((run) => run.film.bounds[0][2])), high = Math.max(...runs.map((run) => run.film.bounds[1][2]));
    this.heights = [low, high];
    find("runs").replaceChildren(...runs.map((run) => run.element));
    for (const run of runs) { run.start(); this.listen(run); run.why.open = runs.length === 1; } // two tables would hide the maps
    this.plot();
    const feature = runs[0].film.feature;
    find("scores").textContent = feature ? `candidates by ${feature}, lowest to highest` : "candidates";
    find("clock").max = this.end;
    this.to(1);
  }

  plot() {
    this.charts = [["observed", "%", "observed"], ["C.R. of means", "%", "completion_ratio"], ["PSNR", "dB", "psnr"],
      ["space known", "%", "known"], ["PSNR of the keyframes, median", "dB", "fidelity"]]
      .map(([name, unit, key]) => new Chart(name, unit, key, this.runs, this.end)).filter((chart) => chart.element);
    find("charts").replaceChildren(...this.charts.map((chart) => chart.element));
  }

  grown() { // adjust the page to new data
    this.end = Math.max(...this.runs.map((run) => run.end));
    find("clock").max = this.end;
    this.plot();
    this.dirty = true;
  }

  shown() { // which layers are drawn
    const [low, high] = this.heights, share = Number(find("cut").value), eye = find("eye").value;
    return { map: find("show-map").checked, planes: find("show-planes").checked, candidates: find("show-candidates").checked,
      path: find("show-path").checked, why: find("show-why") !== null && find("show-why").checked, cut: share >= 1 || eye === "agent" ? 1e6 : low + share * (high - low), eye,
      coarse: this.coarse, playing: this.playing, pointed: this.pointed };
  }

  listen(run) {
    // Both views share one camera.
    const all = (act) => {
      for (const one of this.runs) act(one.orbit);
      this.moved = performance.now();
      this.dirty = true;
    };
    let from = null;
    run.canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    run.canvas.addEventListener("pointerdown", (event) => { from = event; run.canvas.setPointerCapture(event.pointerId); });
    run.canvas.addEventListener("pointerup", () => { from = null; });
    run.canvas.addEventListener("pointermove", (event) => {
      if (!from) return;
      const x = event.clientX - from.clientX, y = event.clientY - from.clientY, moves = event.shiftKey || event.buttons === 2;
      from = event;
      all((orbit) => moves ? orbit.shift(x, y, run.canvas.clientHeight) : orbit.turn(x, y));
    });
    run.canvas.addEventListener("wheel", (event) => { event.preventDefault(); all((orbit) => orbit.zoom(event.deltaY)); }, { passive: false });
  }

  toggle() { if (this.playing) this.pause(); else this.play(); }
  scrub(frame) { this.pause(); this.to(frame); }
  play() { if (this.clock >= this.end) this.to(1); this.playing = true; this.before = null; find("play").textContent = "❚❚ pause"; }
  pause() { this.playing = false; this.dirty = true; find("play").textContent = "▶ play"; }
  step(by) {
    this.pause();
    const frames = this.runs[0].arrays.frames, now = this.runs[0].moment(this.clock);
    const next = Math.min(Math.max(by < 0 && this.clock > frames[now] ? now : now + by, 0), frames.length - 1);
    this.to(frames[next]);
  }
  to(frame) { this.clock = Math.min(Math.max(frame, 1), this.end); this.dirty = true; }

  tick(time) {
    if (this.playing) {
      if (this.before !== null) this.to(this.clock + (time - this.before) / 1000 * this.usual * Number(find("speed").value));
      this.before = time;
      if (this.clock >= this.end) this.pause();
    }
    // A large map is drawn coarsely while the view changes, then in full.
    const coarse = time - this.moved < 180 && this.runs.some((run) => run.scene.count > MANY);
    if (this.coarse && !coarse) this.dirty = true;
    if (!this.dirty) return;
    this.dirty = false;
    this.coarse = coarse;
    const shown = this.shown();
    const dark = window.matchMedia("(prefers-color-scheme: dark)").matches;
    for (const run of this.runs) {
      const frame = Math.min(this.clock, run.end);
      run.scene.draw(run.camera(shown.eye, frame), Math.round(frame), shown, run.overlay(frame, shown), dark ? [0.05, 0.065, 0.085] : [0.93, 0.94, 0.955]);
      run.update(frame);
    }
    for (const chart of this.charts) chart.update(this.clock);
    find("clock").value = Math.round(this.clock);
    find("position").textContent = `frame ${Math.round(this.clock)} of ${this.end}`;
    this.drawn++;
  }
}
