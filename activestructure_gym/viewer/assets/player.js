"use strict";
// Play one or two episodes on one clock, which counts frames used. A live episode grows while it is shown.

const MANY = 20000; // maps with more Gaussians are drawn coarsely while the view is dragged

class Player {
  constructor(runs) {
    this.clock = 1;
    this.playing = false;
    this.dirty = true;
    this.moved = -1e9; // time at which the view was last changed
    this.drawn = 0; // number of images drawn
    this.pointed = null; // the run and the row of the candidate under the pointer
    this.open(runs);
    find("clock").addEventListener("input", (event) => this.scrub(Number(event.target.value)));
    find("play").addEventListener("click", () => this.toggle());
    find("back").addEventListener("click", () => this.step(-1));
    find("on").addEventListener("click", () => this.step(1));
    find("home").addEventListener("click", () => { for (const run of this.runs) run.orbit.reset(); this.dirty = true; });
    for (const place of [".layers", ".controls"]) document.querySelector(place).addEventListener("input", () => { this.dirty = true; });
    for (const news of ["resize", "scroll"]) window.addEventListener(news, () => { this.point(null); this.dirty = true; });
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
    this.measure();
    this.usual = this.end / 20; // frames per second for a playback of 20 s
    const low = Math.min(...runs.map((run) => run.film.bounds[0][2])), high = Math.max(...runs.map((run) => run.film.bounds[1][2]));
    this.heights = [low, high];
    find("runs").replaceChildren(...runs.map((run) => run.element));
    for (const run of runs) {
      run.orbit.home.yaw = runs[0].orbit.home.yaw;
      run.orbit.reset();
      run.start();
      this.listen(run);
      run.why.open = runs.length === 1; // two tables would take the maps' room
    }
    const features = [...new Set(runs.map((run) => run.film.feature).filter(Boolean))]; // runs may differ
    find("scores").textContent = ["other candidates", features.join(" or ")].filter(Boolean).join(", low to high ");
    this.to(1);
  }

  measure() { // adjust the page to the length of the episodes
    this.end = Math.max(...this.runs.map((run) => run.end));
    find("clock").max = this.end;
    this.charts = MEASURES.map((measure) => new Chart(measure, this.runs, this.end)).filter((chart) => chart.element);
    find("charts").replaceChildren(...this.charts.map((chart) => chart.element));
    this.dirty = true;
  }

  shown() { // which layers are drawn
    const [low, high] = this.heights, share = Number(find("cut").value), eye = find("eye").value, cut = low + share * (high - low);
    find("height").textContent = share >= 1 || eye === "agent" ? "nothing" : `${(cut - low).toFixed(1)} m`;
    const layers = Object.fromEntries(["map", "path", "chosen", "candidates", "planes", "tree"].map((name) => [name, ticked(`show-${name}`)]));
    return { ...layers, cut: share >= 1 || eye === "agent" ? 1e6 : cut, eye, coarse: this.coarse, playing: this.playing };
  }

  listen(run) {
    // Both views share one camera.
    const all = (act) => {
      for (const one of this.runs) act(one.orbit);
      this.moved = performance.now();
      this.dirty = true;
    };
    const held = new Map(); // pointers that are down
    const away = () => { const [a, b] = held.values(); return Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY); };
    run.canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    run.canvas.addEventListener("pointerdown", (event) => { held.set(event.pointerId, event); run.canvas.setPointerCapture(event.pointerId); });
    for (const end of ["pointerup", "pointercancel"]) run.canvas.addEventListener(end, (event) => held.delete(event.pointerId));
    run.canvas.addEventListener("pointerleave", () => this.point(null));
    run.canvas.addEventListener("pointermove", (event) => {
      const from = held.get(event.pointerId);
      if (!from) { if (!event.buttons) this.point(run, this.under(run, event), event); return; }
      this.point(null);
      const x = event.clientX - from.clientX, y = event.clientY - from.clientY, moves = event.shiftKey || event.buttons === 2;
      const before = held.size === 2 ? away() : 0;
      held.set(event.pointerId, event);
      if (before) all((orbit) => orbit.zoom(4 * (before - away())));
      else all((orbit) => moves ? orbit.shift(x, y, run.canvas.clientHeight) : orbit.turn(x, y));
    });
    run.canvas.addEventListener("click", (event) => this.point(run, this.under(run, event), event)); // a tap hovers nothing
    run.canvas.addEventListener("wheel", (event) => { event.preventDefault(); this.point(null); all((orbit) => orbit.zoom(event.deltaY)); }, { passive: false });
  }

  under(run, event) { // row of the candidate at the pointer, or -1
    const box = run.canvas.getBoundingClientRect(), shown = this.shown(), frame = Math.min(this.clock, run.end);
    return run.under(event.clientX - box.left, event.clientY - box.top, run.camera(shown.eye, frame), frame, shown);
  }

  point(run, row = -1, event = null) { // show what the candidate under the pointer sees and costs; null: none
    const wanted = row < 0 ? null : { run, row };
    if (wanted && this.pointed && run === this.pointed.run && row === this.pointed.row) return;
    if (!wanted && !this.pointed) return;
    this.pointed = wanted;
    this.dirty = true;
    find("tip").hidden = !wanted;
    for (const one of this.runs) one.canvas.style.cursor = wanted && one === run ? "pointer" : "";
    if (!wanted) return;
    find("tip").replaceChildren(...run.describe(row, Math.min(this.clock, run.end)));
    const box = find("tip").getBoundingClientRect(), gap = 24;
    const left = event.clientX + gap + box.width < innerWidth ? event.clientX + gap : event.clientX - gap - box.width;
    find("tip").style.left = `${Math.max(left, 4)}px`;
    find("tip").style.top = `${Math.max(Math.min(event.clientY - box.height / 2, innerHeight - box.height - 4), 4)}px`;
  }

  toggle() { if (this.playing) this.pause(); else this.play(); }
  scrub(frame) { this.pause(); this.to(frame); }
  play() { if (this.clock >= this.end) this.to(1); this.playing = true; this.before = null; find("play").textContent = "❚❚ pause"; }
  pause() { this.playing = false; this.dirty = true; find("play").textContent = "▶ play"; }
  neighbour(by) { // frame of the decision before or after this one
    const frames = this.runs[0].arrays.frames, now = this.runs[0].moment(this.clock);
    return frames[Math.min(Math.max(by < 0 && this.clock > frames[now] ? now : now + by, 0), frames.length - 1)];
  }
  step(by) { this.scrub(this.neighbour(by)); }
  to(frame) { this.clock = Math.min(Math.max(frame, 1), this.end); this.point(null); this.dirty = true; }

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
    const shown = this.shown(), background = tint("background");
    for (const run of this.runs) {
      const frame = Math.min(this.clock, run.end), pointed = this.pointed && this.pointed.run === run ? this.pointed.row : -1;
      run.scene.draw(run.camera(shown.eye, frame), Math.round(frame), shown, run.overlay(frame, { ...shown, pointed }), background);
      run.update(frame);
    }
    for (const chart of this.charts) chart.update(this.clock);
    find("clock").value = Math.round(this.clock);
    find("position").textContent = `frame ${Math.round(this.clock)} of ${this.runs[0].film.budget}`;
    find("lead").textContent = leader(this.runs, this.clock, this.runs[0].film.budget);
    this.drawn++;
  }
}
