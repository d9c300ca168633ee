const content = {{ content | tojson }};
const at = id => document.getElementById(id);
const make = (tag, text, className) => { const e = document.createElement(tag); if (text !== undefined) e.textContent = text; if (className) e.className = className; return e; };
const layers = ["rgb", "semantic", "range", "pinhole"];
const [scene = 0, frame = 0, layer = "rgb"] = location.hash.slice(1).split("/");
const within = (text, count) => Math.min(count - 1, Math.max(0, Math.trunc(text) || 0));
const state = { scene: within(scene, content.scenes.length), frame: 0, layer: layers.includes(layer) ? layer : "rgb" };
state.frame = within(frame, content.scenes[state.scene].frames.length);

for (const [name, value] of Object.entries(content.facts)) {
  const fact = make("div"); fact.append(make("dt", name), make("dd", value)); at("facts").append(fact);
}
content.scenes.forEach((scene, k) => { const option = make("option", scene.name); option.value = k; at("scene").append(option); });
for (const row of [...content.classes, { name: "Sky", rgb: content.sky }, { name: "Own car, lens border", rgb: [0, 0, 0] }]) {
  const entry = make("span"), swatch = make("span", undefined, "swatch");
  swatch.style.background = `rgb(${row.rgb})`; entry.append(swatch, row.name); at("legend").append(entry);
}
at("pinhole").hidden = !content.scenes.some(scene => scene.pinholes.length);
for (const row of content.table) {
  const line = make("tr", undefined, row[0] === "This dataset" ? "own" : "");
  row.forEach((cell, k) => line.append(typeof cell === "boolean" ? make("td", cell ? "\u2713" : "\u2013", cell ? "mark" : "mark no")
    : make("td", k ? cell.toLocaleString("en") : cell)));
  at("table").append(line);
}
const most = Math.max(...Object.values(content.ours), ...Object.values(content.authors));
const cells = content.classes.map(row => {
  const line = make("tr"), name = make("td"), swatch = make("span", undefined, "swatch"), now = make("td"), bars = make("td", undefined, "fraction");
  swatch.style.background = `rgb(${row.rgb})`;
  name.append(swatch, row.name);
  for (const percent of [content.ours[row.name], content.authors[row.name]]) {
    const bar = make("span"); bar.style.width = `${100 * percent / most}%`; bars.append(bar);
  }
  line.append(name, now, make("td", content.ours[row.name].toFixed(2)), make("td", content.authors[row.name].toFixed(2)), bars);
  at("percent").append(line);
  return now;
});

function show() {
  const scene = content.scenes[state.scene], frame = scene.frames[state.frame];
  at("scene").value = state.scene;
  at("frame").max = scene.frames.length - 1;
  at("frame").value = state.frame;
  at("when").textContent = `${frame.time.toFixed(1)} s`;
  const chips = { place: scene.theme, split: scene.split, weather: scene.weather, "time of day": scene.day, frame: frame.number,
    speed: `${frame.speed.toFixed(1)} m/s`, "moving actors": frame.actors };
  at("chips").replaceChildren(...Object.entries(chips).filter(([, value]) => value !== "").map(([name, value]) => {
    const chip = make("span"); chip.append(make("b", name), value); return chip;
  }));
  const names = state.layer === "pinhole" ? scene.pinholes : scene.cameras;
  const shown = frame[state.layer].map((source, k) => {
    const figure = make("figure", undefined, state.layer === "semantic" || state.layer === "range" ? "pixels" : ""), image = make("img");
    image.src = source; image.alt = `${state.layer}, ${names[k]}`;
    figure.append(image, make("figcaption", names[k]));
    return figure;
  });
  at("cameras").replaceChildren(...shown.length ? shown : [make("p", "Nothing of this kind is recorded at this time.")]);
  history.replaceState(null, "", `#${state.scene}/${state.frame}/${state.layer}`);
  for (const name of ["panorama", "bev", "voxels"]) { at(name).src = frame[name]; at(name).alt = name; }
  cells.forEach((cell, k) => { cell.textContent = frame.percent[k].toFixed(2); });
  at("turn").href = `${content.viewer}#${new URLSearchParams({ scene: scene.name, frame: frame.number })}`;
  for (const tab of at("tabs").children) tab.setAttribute("aria-pressed", tab.dataset.layer === state.layer);
}
function move(scenes, frames) {
  const count = content.scenes.length;
  if (scenes) { state.scene = (state.scene + scenes + count) % count; state.frame = 0; }
  const last = content.scenes[state.scene].frames.length - 1;
  state.frame = Math.min(last, Math.max(0, state.frame + frames));
  show();
}
at("scene").onchange = event => { state.scene = +event.target.value; state.frame = 0; show(); event.target.blur(); };
at("frame").oninput = event => { state.frame = +event.target.value; show(); };
at("before").onclick = () => move(-1, 0);
at("after").onclick = () => move(1, 0);
at("tabs").onclick = event => { if (event.target.dataset.layer) { state.layer = event.target.dataset.layer; show(); } };
document.onkeydown = event => {
  if (event.target.tagName === "SELECT") return;
  const step = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] }[event.key];
  if (step) { event.preventDefault(); move(...step); }
};
show();
