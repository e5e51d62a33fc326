"use strict";
// Show a live episode: request new data from the server and send commands.

const KEY = new URLSearchParams(location.search).get("key") || "";
const FOLLOWS = 3; // per second: rate at which the clock approaches the newest frame
const CLICK = 4; // pixels that the pointer may move during a click

class LivePlayer extends Player {
  constructor(runs) {
    super(runs);
    this.follow();
    find("now").addEventListener("click", () => this.follow());
    find("pace").addEventListener("input", (event) => send({ do: "pace", seconds: Number(event.target.value) }));
  }

  get live() { return this.runs[0].film; }

  follow() { this.following = true; this.dirty = true; }
  // Going back in time does not pause the episode; only the pause button does.
  scrub(frame) { this.following = frame >= this.end; this.to(frame); }
  toggle() { this.follow(); send({ do: this.live.paused ? "go" : "pause" }); }
  step(by) { if (by > 0 && this.following) send({ do: "step" }); else this.scrub(this.neighbour(by)); }

  open(runs) {
    for (const run of this.runs || []) run.close();
    super.open(runs);
  }

  listen(run) {
    super.listen(run);
    let down = null;
    run.canvas.addEventListener("pointerdown", (event) => { down = event; });
    run.canvas.addEventListener("click", (event) => {
      const last = run.arrays.frames.length - 1;
      if (!this.live.chooses || !this.following || run.moment(this.clock) < last) return;
      if (!down || Math.hypot(event.clientX - down.clientX, event.clientY - down.clientY) > CLICK) return;
      const row = this.under(run, event);
      if (row >= 0) send({ do: "visit", row, episode: this.live.episode, moment: last });
    });
  }

  tick(time) {
    if (this.following && this.clock < this.end) {
      const seconds = Math.min((time - (this.stamp || time)) / 1000, 0.5);
      this.to(this.end - this.clock < 0.5 ? this.end : this.clock + (this.end - this.clock) * Math.min(FOLLOWS * seconds, 1));
    }
    this.stamp = time;
    super.tick(time);
    find("play").textContent = this.live.paused ? "▶ go on" : "❚❚ pause";
  }

  update(film) {
    const run = this.runs[0];
    if (film) {
      run.extend(film);
      this.measure();
    }
    const rows = run.arrays.rows;
    run.film.chosen.forEach((row, number) => { rows[number] = row; });
    find("state").textContent = run.film.state;
    find("state").className = run.film.state.replace(/\W.*/, "");
    find("play").disabled = run.film.ended;
    find("pace").value = String(run.film.pace);
    this.point(null);
    this.dirty = true;
  }
}

async function send(command) {
  const answer = await fetch(`/do?key=${KEY}`, { method: "POST", body: JSON.stringify(command) }).catch(() => null);
  if (!answer) return;
  const said = await answer.text();
  if (!answer.ok && answer.status !== 409) find("state").textContent = said;
}

async function watch() {
  let film = null, waited = 250;
  for (;;) {
    const known = film ? { episode: film.episode, moments: film.first + film.arrays.frames.length, version: film.version } : { episode: -1, moments: 0, version: -1 };
    try {
      const answer = await fetch(`/news?key=${KEY}&${new URLSearchParams(known)}`);
      if (answer.status === 403) { find("state").textContent = await answer.text(); return; }
      waited = 250;
      if (answer.status !== 200) continue;
      const news = await unpack(new Uint8Array(await answer.arrayBuffer()));
      if (!film || news.episode !== film.episode) {
        if (window.player) window.player.open([new Run(news, 0)]);
        else window.player = new LivePlayer([new Run(news, 0)]);
        window.player.follow();
        window.player.update(null);
      } else {
        window.player.update(news);
      }
      film = news;
    } catch (error) {
      if (!(error instanceof TypeError)) { // not a network error
        find("runs").append(element("p", { className: "warning" }, `This episode cannot be shown: ${error.message}`));
        throw error;
      }
      find("state").textContent = "the program that serves this page has ended";
      await new Promise((resolve) => { setTimeout(resolve, waited); });
      waited = Math.min(2 * waited, 5000);
    }
  }
}

watch();
