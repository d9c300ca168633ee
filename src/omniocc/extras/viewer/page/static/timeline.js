// The slider over frames, the figures above it, play, and the frames with the worst figures.

import { page } from "omniocc/data.js";
import { at, make, number } from "omniocc/dom.js";

const LISTED = 3;

export class Timeline {
  // `go(frame)` is called when another frame is asked for; it returns a promise that the frame is drawn.
  constructor(go) {
    this.go = go;
    this.playing = false;
    this.figure = page.figures.findIndex(({ key }) => this.values(key).some(Number.isFinite));
    this.run = 0;
    const slider = at("frame");
    slider.max = page.frames.length - 1;
    slider.addEventListener("input", () => go(Number(slider.value)));
    at("before").addEventListener("click", () => this.step(-1));
    at("after").addEventListener("click", () => this.step(1));
    at("play").addEventListener("click", () => this.toggle());
    at("bars").addEventListener("click", event => { const bar = event.target.closest("[data-frame]"); if (bar) go(Number(bar.dataset.frame)); });
    this.drawBars();
    this.drawWorst();
  }

  // Whether any frame of any run has a figure.
  occurs(figure) {
    return page.runs.some((_, run) => this.values(page.figures[figure].key, run).some(Number.isFinite));
  }

  values(key, run = this.run ?? 0) {
    return page.frames.map(({ predictions }) => predictions[run]?.figures[key] ?? NaN);
  }

  // Frames from the worst to the best by the chosen figure; those without it are left out.
  order() {
    if (this.figure < 0) return [];
    const values = this.values(page.figures[this.figure].key);
    return values.map((value, frame) => ({ value, frame })).filter(({ value }) => Number.isFinite(value)).sort((a, b) => a.value - b.value);
  }

  // The first few of that order: never more than half of the frames.
  lowest() {
    const order = this.order();
    return order.slice(0, Math.min(LISTED, Math.floor(order.length / 2)));
  }

  // Go to the worst frame, or from one of the worst to the next in the order.
  worst(step) {
    const order = this.order(), now = order.findIndex(({ frame }) => frame === this.frame);
    const jumped = this.jumped === this.frame && now >= 0;
    if (!order.length) return;
    const next = jumped ? Math.min(Math.max(now + step, 0), order.length - 1) : 0;
    this.jumped = order[next].frame;
    this.go(this.jumped);
  }

  step(by) {
    this.go(Math.min(Math.max(this.frame + by, 0), page.frames.length - 1));
  }

  toggle() {
    this.playing = !this.playing;
    at("play").setAttribute("aria-pressed", this.playing);
    at("play").textContent = this.playing ? "Pause" : "Play";
    if (this.playing) this.play((this.session = Symbol("play")));
  }

  // Go on to the next frame at the chosen speed, or as fast as frames are drawn, until play is toggled.
  async play(own) {
    while (this.playing && own === this.session) {
      const due = performance.now() + 1000 / Number(at("speed").value);
      await this.go((this.frame + 1) % page.frames.length);
      await new Promise(done => setTimeout(done, Math.max(due - performance.now(), 20)));
    }
  }

  show(frame) {
    this.frame = frame;
    const { scene, frame: name, time_s } = page.frames[frame], slider = at("frame");
    slider.value = frame;
    slider.setAttribute("aria-valuetext", `frame ${frame + 1} of ${page.frames.length}, ${scene}, ${name}`);
    at("where").title = scene;
    at("where").replaceChildren(make("b", {}, scene), make("span", {}, `frame ${name}`), make("span", {}, `${time_s.toFixed(1)} s`), make("span", {}, `${frame + 1} of ${page.frames.length}`));
    for (const marked of at("bars").querySelectorAll(".now")) marked.classList.remove("now");
    at("bars").querySelector(`[data-frame="${frame}"]`)?.classList.add("now");
    for (const button of at("worst").querySelectorAll("[data-frame]")) button.setAttribute("aria-current", Number(button.dataset.frame) === frame);
  }

  // Bars of the chosen figure; where a scene begins there is a line.
  drawBars() {
    const key = page.figures[this.figure]?.key, values = key === undefined ? page.frames.map(() => NaN) : this.values(key);
    const worst = new Set(this.lowest().map(({ frame }) => frame)), last = Math.max(page.frames.length - 1, 1);
    const top = Math.max(...values.filter(Number.isFinite), 1e-9);
    const columns = values.map((value, frame) => {
      const begins = frame > 0 && page.frames[frame].scene !== page.frames[frame - 1].scene;
      const names = ["column", ...(begins ? ["begins"] : []), ...(worst.has(frame) ? ["low"] : []), ...(frame === this.frame ? ["now"] : [])];
      const bar = make("i", { style: { height: Number.isFinite(value) ? `${Math.max(100 * value / top, 2)}%` : "0" } });
      const title = `${page.frames[frame].scene}, frame ${page.frames[frame].frame}` + (Number.isFinite(value) ? `: ${page.figures[this.figure].name} ${number(value)}` : "");
      return make("span", { class: names.join(" "), title, "data-frame": frame, style: { left: `${100 * frame / last}%`, width: `min(26px, ${80 / (last + 1)}%)` } }, bar);
    });
    at("bars").replaceChildren(...columns);
    at("bars").hidden = this.figure < 0;
  }

  drawWorst() {
    const lowest = this.lowest();
    if (!lowest.length) return at("worst").replaceChildren(...(this.figure < 0 ? [] : this.choices()));
    const jump = make("button", { title: "Worst first: again for the next worst (w), back (W)" }, "Worst first ", make("kbd", {}, "w"));
    jump.addEventListener("click", () => this.worst(1));
    const listed = lowest.map(({ frame, value }) => {
      const button = make("button", { class: "chip", "data-frame": frame, title: `${page.frames[frame].scene}, frame ${page.frames[frame].frame}` }, `${frame + 1}`, make("small", {}, number(value)));
      button.addEventListener("click", () => { this.jumped = frame; this.go(frame); });
      return button;
    });
    at("worst").replaceChildren(...this.choices(), jump, ...listed);
    return undefined;
  }

  // Which figure and, of several runs, whose.
  choices() {
    const pick = (label, entries, chosen, change) => {
      const select = make("select", { "aria-label": label }, ...entries.map(([text, value]) => make("option", { value, selected: value === chosen }, text)));
      select.addEventListener("change", () => { change(Number(select.value)); this.drawBars(); this.drawWorst(); this.go(this.frame); });
      return select;
    };
    const figures = page.figures.map(({ name }, value) => [name, value]).filter(([, value]) => this.occurs(value));
    const found = [pick("Figure of the bars", figures, this.figure, value => { this.figure = value; })];
    if (page.runs.length > 1) found.push(pick("Run of the bars", page.runs.map((run, value) => [run, value]), this.run, value => { this.run = value; }));
    return found;
  }
}
